//! `host-sim serve`, also the default: a virtual stage controller to talk to.

use super::Failure;
use super::common::load;
use crate::control::Control;
use crate::flash::Flash;
use crate::server::{Options, Speed, Station, serve};
use crate::session::power_up_from;
use mio::Poll;
use std::io::{self, IsTerminal, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, channel};

/// Serves virtual stage controllers over TCP and a pseudo terminal.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine file, or `paper` for the paper's stage.
    #[arg(long, default_value = "paper")]
    machine: PathBuf,
    /// TCP port of the first board; the next ones follow. 0: the system chooses.
    #[arg(long, default_value_t = 5025)]
    port: u16,
    /// `max`, or a factor of real time.
    #[arg(long, default_value = "1", value_parser = speed)]
    speed: Speed,
    /// No pseudo terminal.
    #[arg(long)]
    no_pty: bool,
    /// Controllers: two for the two sides of a chip.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=8))]
    boards: u16,
    /// Address to listen on.
    #[arg(long, default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    bind: IpAddr,
    /// Like a board after power-up: not homed, disabled.
    #[arg(long)]
    cold: bool,
    /// Seed of the interleaving of the controller's two halves.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Keeps what *SAV and SYST:PARK save in this file, as a board does in its flash; without it, in memory until
    /// the end. Saved settings come before the machine's calibration. Further boards append their number: FILE.2.
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// Reads what a hand does at the stage from standard input: `stop open`, `stop closed`, `fault 2 on`, `fault 2 off`.
    #[arg(long)]
    console: bool,
}

/// The flash of a board, counted from 0.
fn flash(settings: Option<&Path>, board: u16) -> Result<Flash, Failure> {
    let Some(path) = settings else { return Ok(Flash::blank()) };
    let mut name = path.as_os_str().to_owned();
    if board > 0 {
        name.push(format!(".{}", board + 1));
    }
    Flash::file(Path::new(&name)).map_err(|source| Failure::Io { path: name.to_string_lossy().into_owned(), source })
}

fn speed(text: &str) -> Result<Speed, String> {
    match text {
        "max" => Ok(Speed::Max),
        _ => match text.parse::<f64>() {
            Ok(factor) if (0.001..=1000.0).contains(&factor) => Ok(Speed::Factor(factor)),
            _ => Err("`max` or a factor from 0.001 to 1000".to_owned()),
        },
    }
}

impl Args {
    /// Serves until interrupted.
    ///
    /// # Errors
    /// A machine that is refused, an address that cannot be used.
    pub fn run(&self) -> Result<(), Failure> {
        let machine = load(&self.machine)?;
        let net = |source| Failure::Io { path: format!("{}:{}", self.bind, self.port), source };
        let poll = Poll::new().map_err(net)?;
        let mut stations = Vec::new();
        for board in 0..self.boards {
            let port = match self.port {
                0 => 0,
                first => first.checked_add(board).ok_or_else(|| Failure::Refused("port above 65535".to_owned()))?,
            };
            let options = Options {
                address: SocketAddr::new(self.bind, port),
                pty: !self.no_pty,
                speed: self.speed,
                seed: self.seed.wrapping_add(board.into()),
            };
            let at = |source: io::Error| {
                let hint = if source.kind() == io::ErrorKind::AddrInUse { " (--port takes another)" } else { "" };
                Failure::Io { path: format!("{}{hint}", options.address), source }
            };
            let refused = |reason| Failure::Refused(format!("{}: {reason}", self.machine.display()));
            let mut store = flash(self.settings.as_deref(), board)?.store();
            let front = power_up_from(&mut store, &machine, self.cold).map_err(refused)?;
            stations.push(Station::new(&machine, front, store, &options, &poll).map_err(at)?);
        }
        println!("Stage controller, machine \"{}\"", machine.name);
        for (n, station) in stations.iter_mut().enumerate() {
            println!("Board {}", n + 1);
            println!("  TCP  {}", station.address().map_err(net)?);
            if let Some(path) = station.terminal() {
                println!("  PTY  {}", path.display());
            }
        }
        if let Some(address) = stations.first().and_then(|s| s.address().ok()) {
            println!("\nFrom Python (pip install pyvisa pyvisa-py):\n{}", snippet(address));
        }
        let _ = io::stdout().flush();
        let live = io::stderr().is_terminal();
        let status = |line: &str| {
            if live {
                // without wrapping: a line that is too long is cut
                eprint!("\r\x1b[K\x1b[?7l{line}\x1b[?7h");
            }
        };
        let words = self.console.then(console);
        let hand = || words.as_ref().and_then(|words| words.try_recv().ok());
        serve(&mut stations, poll, status, hand, || false).map_err(net)
    }
}

/// What standard input says a hand does, from a thread that waits for it.
fn console() -> Receiver<Control> {
    let (said, heard) = channel();
    std::thread::spawn(move || {
        for line in io::stdin().lines().map_while(Result::ok).filter(|line| !line.trim().is_empty()) {
            match line.parse() {
                Ok(control) => drop(said.send(control)),
                Err(why) => eprintln!("{why}"),
            }
        }
    });
    heard
}

/// Three lines that work when pasted.
fn snippet(address: SocketAddr) -> String {
    let host = if address.ip().is_unspecified() { Ipv4Addr::LOCALHOST.into() } else { address.ip() };
    format!(
        "import pyvisa\nstage = pyvisa.ResourceManager(\"@py\").open_resource(\"TCPIP::{host}::{}::SOCKET\", \
         read_termination=\"\\n\", write_termination=\"\\n\")\n\
         print(stage.query(\"POSE 100,-50,20,0.1,0,-0.2;*OPC?;POSE?\"))\n",
        address.port()
    )
}
