//! `host-sim report`: everything about a machine on one page.

use super::Failure;
use super::common::{load, say, say_json, with_progress};
use crate::report::{Report, render};
use std::io;
use std::path::{Path, PathBuf};

/// Write one self-contained HTML page about a machine: chain and tables, sensitivities (um), errors over the travel
/// (um, urad), what each compensation buys (um), what fixed point costs (nm), the numbers of the paper.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine file (TOML), or `paper` for the built-in machine.
    machine: PathBuf,
    /// Where the page is written. Needed unless --json is given.
    #[arg(short, long, value_name = "FILE", required_unless_present = "json")]
    output: Option<PathBuf>,
    /// Print the figures of the page as one JSON object on stdout.
    #[arg(long)]
    json: bool,
    /// Date that the page bears, as text; without it the page bears none (nothing looks at a clock).
    #[arg(long, value_name = "TEXT")]
    date: Option<String>,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let machine = load(&self.machine)?;
        if let Some(path) = &self.output {
            writable(path)?;
        }
        let file = self.machine.file_name().map_or_else(|| machine.name.clone(), |name| name.to_string_lossy().into());
        let report = with_progress(Report::progress_steps(), "fields", |progress| {
            Report::new(&machine, &file, self.date.as_deref(), progress)
        });
        if let Some(path) = &self.output {
            let page = render(&report);
            replace(path, page.as_bytes())
                .map_err(|source| Failure::Io { path: path.display().to_string(), source })?;
            if !self.json {
                say(format!("{} bytes written to {}", page.len(), path.display()))?;
            }
        }
        if self.json {
            say_json(&report)?;
        }
        Ok(())
    }
}

/// Refuses before anything is computed what could not be written afterwards.
fn writable(path: &Path) -> Result<(), Failure> {
    let refused = |kind, reason: &str| Failure::Io {
        path: path.display().to_string(),
        source: io::Error::new(kind, reason.to_string()),
    };
    if path.is_dir() {
        return Err(refused(io::ErrorKind::IsADirectory, "is a folder; name a file in it"));
    }
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() && !folder.is_dir() => {
            Err(refused(io::ErrorKind::NotFound, "its folder does not exist"))
        }
        _ => Ok(()),
    }
}

/// Writes beside the file and renames: there is either the old file or the whole new one.
fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.part", std::process::id()));
    let part = path.with_file_name(name);
    let written = std::fs::write(&part, bytes).and_then(|()| std::fs::rename(&part, path));
    if written.is_err() {
        let _ = std::fs::remove_file(&part);
    }
    written
}
