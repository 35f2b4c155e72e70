//! `host-sim load`: sends a calibration block to a controller.

use super::Failure;
use crate::server::make_raw;
use std::fs::OpenOptions;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::time::Duration;

/// Sends a calibration block to a controller.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The block that `host-sim calibrate` wrote.
    file: PathBuf,
    /// `tcp://HOST:PORT` or the path of a serial port.
    #[arg(long)]
    to: String,
}

/// Longest wait for an answer.
const TIMEOUT: Duration = Duration::from_secs(5);

trait Wire: Read + Write {}
impl<T: Read + Write> Wire for T {}

impl Args {
    /// Sends the block and says what the controller made of it.
    ///
    /// # Errors
    /// A file or a link that cannot be used; status 2 when the controller refuses the block.
    pub fn run(&self) -> Result<(), Failure> {
        let block = std::fs::read(&self.file)
            .map_err(|source| Failure::Io { path: self.file.display().to_string(), source })?;
        let at = |source| Failure::Io { path: self.to.clone(), source };
        let mut wire = self.open().map_err(at)?;
        let length = block.len().to_string();
        let mut message = format!("*CLS;COMP:LOAD #{}{length}", length.len()).into_bytes();
        message.extend_from_slice(&block);
        message.extend_from_slice(b"\nSYST:ERR?;:COMP:NAME?;CRC?\n");
        wire.write_all(&message).map_err(at)?;
        wire.flush().map_err(at)?;
        let answer = line(&mut wire).map_err(at)?;
        let Some((error, loaded)) = answer.split_once("\";") else {
            // nothing loaded at all: only the error came back
            return Err(Failure::Refused(format!("the controller says {answer}")));
        };
        match error.strip_prefix("0,") {
            Some(_) => {
                println!("Loaded {loaded} ({} bytes); in force until power-off.", block.len());
                Ok(())
            }
            None => Err(Failure::Refused(format!("the controller says {error}\""))),
        }
    }

    fn open(&self) -> std::io::Result<Box<dyn Wire>> {
        if let Some(address) = self.to.strip_prefix("tcp://") {
            let stream = TcpStream::connect(address)?;
            stream.set_read_timeout(Some(TIMEOUT))?;
            return Ok(Box::new(stream));
        }
        let port = OpenOptions::new().read(true).write(true).open(&self.to)?;
        make_raw(&port)?;
        Ok(Box::new(port))
    }
}

/// One line, without its LF.
fn line(wire: &mut dyn Wire) -> std::io::Result<String> {
    let mut bytes = Vec::new();
    let mut byte = [0];
    loop {
        if wire.read(&mut byte)? == 0 {
            return Err(std::io::Error::new(std::io::ErrorKind::UnexpectedEof, "the link closed without an answer"));
        }
        match byte[0] {
            b'\n' => return Ok(String::from_utf8_lossy(&bytes).trim_end().to_owned()),
            other => bytes.push(other),
        }
    }
}
