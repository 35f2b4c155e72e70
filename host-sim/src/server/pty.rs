//! A pseudo terminal as the board's serial port.
//!
//! The slave is not held open, so that the hang-up of the client is seen (EIO on the master). Linux resets the
//! terminal's modes with its last close, so they are set raw anew each time somebody opens it.

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::pty::openpty;
use nix::sys::termios::{FlushArg, SetArg, cfmakeraw, tcflush, tcgetattr, tcsetattr};
use nix::unistd::ttyname;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

/// Master side of a pseudo terminal.
#[derive(Debug)]
pub struct Pty {
    master: File,
    path: PathBuf,
    open: bool,
}

/// Raw mode: bytes as they are, no echo.
///
/// # Errors
/// Those of the terminal.
pub fn make_raw(terminal: impl AsFd) -> io::Result<()> {
    let mut modes = tcgetattr(&terminal)?;
    cfmakeraw(&mut modes);
    tcsetattr(&terminal, SetArg::TCSANOW, &modes)?;
    Ok(())
}

impl Pty {
    /// Opens a new one.
    ///
    /// # Errors
    /// Those of the system.
    pub fn new() -> io::Result<Self> {
        let pair = openpty(None, None)?;
        let path = ttyname(&pair.slave)?;
        make_raw(&pair.slave)?;
        let flags = OFlag::from_bits_truncate(fcntl(&pair.master, FcntlArg::F_GETFL)?);
        fcntl(&pair.master, FcntlArg::F_SETFL(flags | OFlag::O_NONBLOCK))?;
        Ok(Pty { master: File::from(pair.master), path, open: false })
    }

    /// Where the client opens it.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn opened(&mut self) {
        if !self.open {
            self.open = true;
            self.renew();
        }
    }

    /// Raw mode, and without the answers that the last client has not read. What a client has written stays.
    fn renew(&self) {
        let flags = OFlag::O_NOCTTY.bits();
        // best effort: the client may have gone again
        if let Ok(slave) = OpenOptions::new().read(true).write(true).custom_flags(flags).open(&self.path) {
            let _ = make_raw(&slave);
            let _ = tcflush(&slave, FlushArg::TCIFLUSH);
        }
    }
}

impl Read for Pty {
    /// Zero bytes: nobody has it open.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self.master.read(buffer) {
            Err(error) if error.raw_os_error() == Some(nix::errno::Errno::EIO as i32) => {
                if self.open {
                    self.open = false;
                    self.renew();
                }
                Ok(0)
            }
            result => {
                self.opened();
                result
            }
        }
    }
}

impl Write for Pty {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.master.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.master.flush()
    }
}

impl AsFd for Pty {
    fn as_fd(&self) -> std::os::fd::BorrowedFd<'_> {
        self.master.as_fd()
    }
}
