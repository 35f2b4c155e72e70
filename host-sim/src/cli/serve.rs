//! `host-sim serve`, also the default: a virtual stage controller to talk to.

use super::Failure;
use super::common::load;
use crate::bench_twin::{self, Bench, Side, Start};
use crate::control::Hand;
use crate::flash::Flash;
use crate::gpib::{Bus, Ports};
use crate::machine::Machine;
use crate::server::{BenchStation, Boards, MeterStation, OnBus, OnHislip, Options, Served, Speed, Station, serve};
use crate::session::power_up_from;
use mio::Poll;
use std::io::{self, IsTerminal, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, channel};

/// Serves virtual stage controllers over TCP and a pseudo terminal.
///
/// With `--bench` there are two of them, input side and output side, before one bench for aligning a splitter chip, and
/// on a third port the power meter with its optical switch. docs/BENCH.md has its commands.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine file, or `paper` for the paper's stage. With `--bench`: the drawing of both its stages.
    #[arg(long, default_value = "paper")]
    machine: PathBuf,
    /// Two controllers before the bench that this seed draws, and its power meter on the port behind theirs.
    #[arg(long, value_name = "SEED", num_args = 0..=1, default_missing_value = "1", conflicts_with = "boards")]
    bench: Option<u64>,
    /// The bench starts +-30 um off; without it +-10 um.
    #[arg(long, requires = "bench")]
    coarse: bool,
    /// TCP port of the first board; the next ones follow. 0: the system chooses.
    #[arg(long, default_value_t = 5025)]
    port: u16,
    /// TCP port of a GPIB gateway, as a Prologix GPIB-ETHERNET has it: boards at the addresses 5, 6, ... and behind them
    /// the power meter of a bench; docs/BUS.md. 0: the system chooses.
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "1234")]
    gpib: Option<u16>,
    /// TCP port of a HiSLIP server: boards are `hislip0`, `hislip1`, ..., and behind them the power meter of a bench.
    /// 0: the system chooses.
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "4880")]
    hislip: Option<u16>,
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
    /// Reads what a hand does at the stage from standard input: `stop open`, `stop closed`, `fault 2 on`, `fault 2 off`;
    /// at a bench also `laser off`, `laser 0` (dBm), `fibre 3 broken`, `fibre 3 whole`.
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
        let poll = Poll::new().map_err(|source| self.net(source))?;
        match self.bench {
            Some(seed) => self.serve_bench(seed, machine, poll),
            None => self.serve_boards(&machine, poll),
        }
    }

    fn serve_boards(&self, machine: &Machine, poll: Poll) -> Result<(), Failure> {
        let stations = (0..self.boards).map(|board| self.station(board, machine, machine, &poll));
        let mut stations = stations.collect::<Result<Vec<_>, _>>()?;
        println!("Stage controller, machine \"{}\"", machine.name);
        for (n, station) in stations.iter_mut().enumerate() {
            self.introduce(&format!("Board {}", n + 1), station)?;
        }
        if let Some(address) = stations.first().and_then(|s| s.address().ok()) {
            println!("\nFrom Python (pip install pyvisa pyvisa-py):\n{}", snippet(address));
        }
        if self.gpib.is_none() && self.hislip.is_none() {
            return self.until_interrupted(&mut stations, poll);
        }
        self.serve_on_bus(Boards::new(stations).ok_or_else(no_link)?, poll)
    }

    /// Serves behind a gateway too, if one is wanted.
    fn serve_on_bus(&self, served: impl Served + Bus + Ports, poll: Poll) -> Result<(), Failure> {
        let Some(port) = self.gpib else { return self.serve_on_hislip(served, poll) };
        let address = SocketAddr::new(self.bind, port);
        let served = OnBus::new(served, address, &poll).map_err(|source| at("--gpib", address, source))?;
        println!("GPIB gateway\n  GPIB  {}", served.address().map_err(|source| self.net(source))?);
        self.serve_on_hislip(served, poll)
    }

    /// Serves HiSLIP clients too, if they are wanted.
    fn serve_on_hislip(&self, served: impl Served + Ports, poll: Poll) -> Result<(), Failure> {
        let Some(port) = self.hislip else { return self.until_interrupted(&mut [served], poll) };
        let address = SocketAddr::new(self.bind, port);
        let served = OnHislip::new(served, address, &poll).map_err(|source| at("--hislip", address, source))?;
        println!("HiSLIP server\n  HiSLIP  {}", served.address().map_err(|source| self.net(source))?);
        self.until_interrupted(&mut [served], poll)
    }

    fn serve_bench(&self, seed: u64, drawing: Machine, poll: Poll) -> Result<(), Failure> {
        let start = if self.coarse { Start::COARSE } else { Start::CAMERAS };
        let name = drawing.name.clone();
        let bench = Bench::seeded(seed, &bench_twin::Options { drawing, start, ..bench_twin::Options::default() });
        let station = |side: Side| {
            let refused = |reason| Failure::Refused(format!("bench {seed}: {reason}"));
            let believed = bench.calibrated(side).map_err(|refusal| refused(refusal.to_string()))?.machine;
            self.station(side.index() as u16, bench.machine(side), &believed, &poll)
        };
        let mut stations = [station(Side::Input)?, station(Side::Output)?];
        let address = SocketAddr::new(self.bind, self.port_of(2)?);
        let meter = MeterStation::new(address, &poll).map_err(|source| at("--port", address, source))?;
        println!("Bench {seed}, two stages of machine \"{name}\"");
        for (side, station) in ["Input side", "Output side"].into_iter().zip(&mut stations) {
            self.introduce(side, station)?;
        }
        println!("Power meter\n  TCP  {}", meter.address().map_err(|source| self.net(source))?);
        let mut bench = BenchStation::new(bench, stations, meter, self.speed);
        if self.gpib.is_some() && !bench.attach() {
            return Err(no_link());
        }
        self.serve_on_bus(bench, poll)
    }

    /// A board, counted from 0, that turns the motors of `truth` and knows what `believed` says of it.
    fn station(&self, board: u16, truth: &Machine, believed: &Machine, poll: &Poll) -> Result<Station, Failure> {
        let options = Options {
            address: SocketAddr::new(self.bind, self.port_of(board)?),
            pty: !self.no_pty,
            speed: self.speed,
            seed: self.seed.wrapping_add(board.into()),
        };
        let refused = |reason| Failure::Refused(format!("{}: {reason}", self.machine.display()));
        let mut store = flash(self.settings.as_deref(), board)?.store();
        let front = power_up_from(&mut store, believed, self.cold).map_err(refused)?;
        Station::new(truth, front, store, &options, poll).map_err(|source| at("--port", options.address, source))
    }

    /// Port of a board or of the meter behind them.
    fn port_of(&self, n: u16) -> Result<u16, Failure> {
        match self.port {
            0 => Ok(0),
            first => first.checked_add(n).ok_or_else(|| Failure::Refused("port above 65535".to_owned())),
        }
    }

    fn net(&self, source: io::Error) -> Failure {
        Failure::Io { path: format!("{}:{}", self.bind, self.port), source }
    }

    /// Says where a board is found.
    fn introduce(&self, name: &str, station: &mut Station) -> Result<(), Failure> {
        println!("{name}\n  TCP  {}", station.address().map_err(|source| self.net(source))?);
        if let Some(path) = station.terminal() {
            println!("  PTY  {}", path.display());
        }
        Ok(())
    }

    fn until_interrupted<S: Served>(&self, served: &mut [S], poll: Poll) -> Result<(), Failure> {
        let _ = io::stdout().flush();
        let live = io::stderr().is_terminal();
        let status = |line: &str| {
            if live {
                // without wrapping: a line that is too long is cut
                eprint!("\r\x1b[K\x1b[?7l{line}\x1b[?7h");
            }
        };
        let words = self.console.then(|| console(self.bench.is_some()));
        let hand = || words.as_ref().and_then(|words| words.try_recv().ok());
        serve(served, poll, status, hand, || false).map_err(|source| self.net(source))
    }
}

fn no_link() -> Failure {
    Failure::Refused("a board has no link left for the bus".to_owned())
}

/// What has become of an address that an `option` gives.
fn at(option: &str, address: SocketAddr, source: io::Error) -> Failure {
    let taken = source.kind() == io::ErrorKind::AddrInUse;
    let hint = if taken { format!(" ({option} takes another)") } else { String::new() };
    Failure::Io { path: format!("{address}{hint}"), source }
}

/// What standard input says a hand does, from a thread that waits for it.
fn console(bench: bool) -> Receiver<Hand> {
    let (said, heard) = channel();
    std::thread::spawn(move || {
        for line in io::stdin().lines().map_while(Result::ok).filter(|line| !line.trim().is_empty()) {
            match Hand::parse(&line, bench) {
                Ok(hand) => drop(said.send(hand)),
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
