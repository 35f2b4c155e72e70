//! An accepted TCP connection that wakes the server, and is acknowledged at once.

use super::link::State;
use super::station::TOKEN;
use mio::net::TcpStream;
use mio::{Interest, Registry};
use nix::sys::socket::{setsockopt, sockopt};
use std::io::{self, Read, Write};
use std::os::fd::AsFd;

/// A side that does not answer any more is missed after so long without a byte, and then so many questions, s.
#[cfg(target_os = "linux")]
const KEEP_ALIVE: (u32, u32, u32) = (30, 10, 3);

/// A connection.
#[derive(Debug)]
pub(super) struct Socket {
    stream: TcpStream,
    /// The same one, for what only the standard library can set.
    twin: Option<std::net::TcpStream>,
}

impl Socket {
    /// A connection that was just accepted. What cannot be set only makes it slower.
    pub fn accepted(mut stream: TcpStream, registry: &Registry) -> Self {
        let _ = stream.set_nodelay(true);
        let _ = setsockopt(&stream, sockopt::KeepAlive, &true);
        #[cfg(target_os = "linux")]
        {
            let (idle, interval, count) = KEEP_ALIVE;
            let _ = setsockopt(&stream, sockopt::TcpKeepIdle, &idle);
            let _ = setsockopt(&stream, sockopt::TcpKeepInterval, &interval);
            let _ = setsockopt(&stream, sockopt::TcpKeepCount, &count);
        }
        let _ = registry.register(&mut stream, TOKEN, Interest::READABLE);
        let twin = stream.as_fd().try_clone_to_owned().ok().map(std::net::TcpStream::from);
        Socket { stream, twin }
    }

    /// What has become of the other side, though there may be bytes in front of that.
    pub fn other_side(&self) -> State {
        #[cfg(target_os = "linux")]
        {
            use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
            let shows =
                |what| poll(&mut [PollFd::new(self.stream.as_fd(), what)], PollTimeout::ZERO).is_ok_and(|n| n > 0);
            // a reset shows unasked; the end of what the other side sends does not
            if shows(PollFlags::empty()) {
                return State::Gone;
            }
            if shows(PollFlags::from_bits_retain(nix::libc::POLLRDHUP)) {
                return State::Ended;
            }
        }
        State::Open
    }

    /// Most clients hold a second line back until the first is acknowledged (Nagle's algorithm), and a first line without
    /// an answer would be acknowledged after 40 ms. The system forgets this after a while.
    fn acknowledge(&self) {
        #[cfg(target_os = "linux")]
        if let Some(twin) = &self.twin {
            let _ = std::os::linux::net::TcpStreamExt::set_quickack(twin, true);
        }
        #[cfg(not(target_os = "linux"))]
        let _ = &self.twin;
    }
}

impl Read for Socket {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.stream.read(buffer);
        if read.is_ok() {
            self.acknowledge();
        }
        read
    }
}

impl Write for Socket {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.stream.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}
