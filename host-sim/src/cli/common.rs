//! What several subcommands begin with: a machine, a homed front, a board; how they show progress, and how they write
//! files: all of them or none.

use super::Failure;
use crate::board::{Board, Interleaving};
use crate::machine::{Machine, MachineError};
use crate::session::power_up;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::fmt::Display;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::Once;
use std::time::{Duration, Instant};

/// What takes longer shows a bar, or a line.
const PATIENCE: Duration = Duration::from_secs(1);

/// A machine file, or the built-in machine by its name when there is no such file.
pub fn load(path: &Path) -> Result<Machine, Failure> {
    if path == Path::new("paper") && !path.exists() {
        return Ok(Machine::paper());
    }
    Machine::load(path).map_err(|error| match error {
        MachineError::Read { path, source } => Failure::Io { path, source },
        other => Failure::Refused(format!("{}: {other}", path.display())),
    })
}

/// Writes a line or several to standard output. A reader that has seen enough and went away is no failure.
pub fn say(text: impl Display) -> Result<(), Failure> {
    let mut text = text.to_string();
    if !text.ends_with('\n') {
        text.push('\n');
    }
    say_bytes(text.as_bytes())
}

/// Writes bytes to standard output as they are: an answer may be a block.
pub fn say_bytes(bytes: &[u8]) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(source) if source.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Io { path: "standard output".into(), source })
        }
        _ => Ok(()),
    }
}

/// The same of a result as one JSON object.
pub fn say_json(result: &impl serde::Serialize) -> Result<(), Failure> {
    say(serde_json::to_string_pretty(result).expect("a result is plain data"))
}

/// A board in front of the machine's twin with its calibration, at rest; unless `cold`, homed at 0 on the reference
/// flank, and enabled.
pub fn board(machine: &Machine, cold: bool) -> Result<Board, Failure> {
    let refused = |reason: String| Failure::Refused(format!("{}: {reason}", machine.name));
    let front = power_up(machine, cold).map_err(refused)?;
    let mut board = Board::new(machine, front, Interleaving::Prompt, 0);
    board.settle();
    Ok(board)
}

/// Work that calls back `total` times, from any thread. On a terminal a bar shows when it takes longer than a second.
pub fn with_progress<T>(total: u64, things: &str, work: impl FnOnce(&(dyn Fn() + Sync)) -> T) -> T {
    let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::hidden());
    let template = format!("{{wide_bar}} {{pos}}/{{len}} {things}, {{eta}} left");
    bar.set_style(ProgressStyle::with_template(&template).expect("the template is valid"));
    let (begun, shown) = (Instant::now(), Once::new());
    let result = work(&|| {
        bar.inc(1);
        if begun.elapsed() > PATIENCE {
            shown.call_once(|| bar.set_draw_target(ProgressDrawTarget::stderr()));
        }
    });
    bar.finish_and_clear();
    result
}

/// A line on a terminal's stderr that says what is being done, once that takes longer than a second.
pub struct Spinner {
    since: Instant,
    bar: Option<ProgressBar>,
}

impl Spinner {
    /// Shows nothing yet.
    pub fn new() -> Self {
        Spinner { since: Instant::now(), bar: None }
    }

    /// Says what is being done now.
    pub fn show(&mut self, what: &str) {
        if self.since.elapsed() > PATIENCE {
            // draws on stderr, and only if that is a terminal
            let bar = self.bar.get_or_insert_with(ProgressBar::new_spinner);
            bar.set_message(what.to_string());
            bar.tick();
        }
    }

    /// Takes the line away.
    pub fn clear(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Refuses before anything is computed what could not be written afterwards.
///
/// # Errors
/// The path is a folder, or its folder is not there or takes no file.
pub fn writable(path: &Path) -> Result<(), Failure> {
    if path.is_dir() {
        return Err(unwritable(path, io::Error::new(ErrorKind::IsADirectory, "is a folder; name a file in it")));
    }
    if path.exists() && !path.is_file() {
        return Ok(());
    }
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() && !folder.is_dir() => {
            Err(unwritable(path, io::Error::new(ErrorKind::NotFound, "its folder does not exist")))
        }
        // permissions alone do not tell what a file system takes
        _ => {
            let trial = part(path);
            std::fs::write(&trial, []).and_then(|()| std::fs::remove_file(&trial)).map_err(|e| unwritable(path, e))
        }
    }
}

/// Refuses a folder that is neither there nor can be made because a file stands in its way.
///
/// # Errors
/// The nearest thing above that exists, or the path itself, is no folder.
pub fn folder(path: &Path) -> Result<(), Failure> {
    match path.ancestors().find(|above| above.exists()) {
        Some(above) if !above.is_dir() => {
            Err(unwritable(above, io::Error::new(ErrorKind::NotADirectory, "is a file, not a folder")))
        }
        _ => Ok(()),
    }
}

/// Refuses an output that is one of the files read, by whatever name.
///
/// # Errors
/// Names the file read.
pub fn spares(output: &Path, read: &[impl AsRef<Path>]) -> Result<(), Failure> {
    let Ok(written) = output.canonicalize() else {
        return Ok(());
    };
    match read.iter().find(|path| path.as_ref().canonicalize().is_ok_and(|path| path == written)) {
        Some(path) => Err(Failure::Refused(format!(
            "{}: would overwrite {}, which is read; name another file",
            output.display(),
            path.as_ref().display()
        ))),
        None => Ok(()),
    }
}

/// Writes files beside their places and renames them once all are written: there are the old files or the whole new
/// ones. What is no plain file, such as a pipe, is written as it stands.
///
/// # Errors
/// The first file that cannot be written.
pub fn replace(files: &[(impl AsRef<Path>, &[u8])]) -> Result<(), Failure> {
    let mut parts = Vec::new();
    let done = write_all(files, &mut parts);
    if done.is_err() {
        for (part, _) in parts {
            let _ = std::fs::remove_file(part);
        }
    }
    done
}

fn write_all(files: &[(impl AsRef<Path>, &[u8])], parts: &mut Vec<(PathBuf, PathBuf)>) -> Result<(), Failure> {
    for (path, bytes) in files {
        let path = path.as_ref();
        // a link stays a link
        let place = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
        let target = if place.exists() && !place.is_file() {
            place
        } else {
            parts.push((part(&place), place));
            parts[parts.len() - 1].0.clone()
        };
        std::fs::write(target, bytes).map_err(|source| unwritable(path, source))?;
    }
    parts.iter().try_for_each(|(part, place)| std::fs::rename(part, place).map_err(|source| unwritable(place, source)))
}

/// Where a file is written until it is whole.
fn part(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.part", std::process::id()));
    path.with_file_name(name)
}

fn unwritable(path: &Path, source: io::Error) -> Failure {
    Failure::Io { path: path.display().to_string(), source }
}
