//! A board with one link and no wire: commands as text, answers as text, virtual time only when asked for.

use crate::board::{Board, Played};
use crate::control::Control;
use crate::light::Light;
use stage_controller::controller::links::Links;
use stage_controller::units::SEGMENT_NS;

/// Virtual time after which a line that is still not answered is given up: three hours.
const PATIENCE_SEGMENTS: u64 = 3 * 3_600_000_000_000 / SEGMENT_NS;

/// A board and its one link.
pub struct Console {
    /// The board.
    pub board: Board,
    links: Links<1>,
    link: usize,
    /// What the power inputs see.
    light: Option<Light>,
}

impl Console {
    /// Opens the link of a board.
    pub fn new(board: Board) -> Self {
        let mut links = Links::new();
        let link = links.open(0).unwrap_or(0);
        Console { board, links, link, light: None }
    }

    /// Lets light fall on the power inputs from now on.
    pub fn set_light(&mut self, light: Light) {
        self.light = Some(light);
    }

    /// Virtual time, ms.
    fn now_ms(&self) -> u64 {
        self.board.now() * SEGMENT_NS / 1_000_000
    }

    /// Sends bytes as they are and takes what is answered at once; no time passes.
    pub fn exchange(&mut self, bytes: &[u8]) -> Vec<u8> {
        let (mut rest, mut answer) = (bytes, Vec::new());
        loop {
            let now_ms = self.now_ms();
            let taken = self.links.receive(self.link, rest, now_ms);
            rest = &rest[taken..];
            let progress = self.links.poll(&mut self.board.front, now_ms);
            let before = answer.len();
            self.drain(&mut answer);
            if !progress && taken == 0 && answer.len() == before {
                return answer;
            }
        }
    }

    fn drain(&mut self, answer: &mut Vec<u8>) {
        let mut chunk = [0; 256];
        loop {
            match self.links.transmit(self.link, &mut chunk) {
                0 => return,
                n => answer.extend_from_slice(&chunk[..n]),
            }
        }
    }

    /// One segment of virtual time; answers that it brings.
    pub fn step(&mut self, observe: impl FnMut(Played<'_>)) -> Vec<u8> {
        self.board.step(observe);
        if let Some(light) = &self.light {
            light.shine(&mut self.board);
        }
        self.links.observe(&self.board.front);
        self.exchange(b"")
    }

    /// Sends a line and lets time pass until its answer is there, if it has a query in it, or until it is executed.
    pub fn line(&mut self, line: &str, observe: impl FnMut(Played<'_>)) -> String {
        String::from_utf8_lossy(&self.line_bytes(line, observe)).into_owned()
    }

    /// [`Console::line`] with the answer as it is: there may be a block in it.
    pub fn line_bytes(&mut self, line: &str, mut observe: impl FnMut(Played<'_>)) -> Vec<u8> {
        let mut answer = self.exchange(format!("{line}\n").as_bytes());
        // a query of its own marks the end of what the line says
        answer.extend(self.exchange(b"*STB?\n"));
        let lines = |bytes: &[u8]| bytes.iter().filter(|b| **b == b'\n').count();
        for _ in 0..PATIENCE_SEGMENTS {
            if answer.ends_with(b"\n") && self.links.is_quiet(self.link) && lines(&answer) > 0 {
                break;
            }
            answer.extend(self.step(&mut observe));
        }
        // without the answer of the mark
        let answer = answer.strip_suffix(b"\n").unwrap_or(&answer);
        let own = answer.iter().rposition(|byte| *byte == b'\n').unwrap_or(0);
        answer[..own].to_vec()
    }

    /// Runs a script: a line each; `#` begins a comment, `@12.5` lets 12.5 ms pass, `@stop open` and the other words of
    /// [`Control`] are what a hand does at the stage. The queries' answers, a line each.
    ///
    /// # Errors
    /// What is neither a time nor a word, with its line.
    pub fn script(&mut self, script: &str, mut observe: impl FnMut(Played<'_>)) -> Result<Vec<Vec<u8>>, String> {
        let mut answers = Vec::new();
        for (number, line) in script.lines().map(str::trim).enumerate() {
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let answer = match line.strip_prefix('@') {
                Some(word) if word.trim().starts_with(|c: char| c.is_ascii_alphabetic()) => {
                    let control: Control = word.parse().map_err(|why| format!("line {}: {why}", number + 1))?;
                    control.apply(&mut self.board);
                    continue;
                }
                Some(time) => {
                    let ms = time.trim().parse::<f64>().ok().filter(|ms| (0.0..1e7).contains(ms));
                    let ms = ms.ok_or_else(|| format!("line {}: {line:?} is no time in ms", number + 1))?;
                    let segments = (ms * 1e6 / SEGMENT_NS as f64).round() as u64;
                    (0..segments).map(|_| self.step(&mut observe)).for_each(drop);
                    continue;
                }
                None => self.line_bytes(line, &mut observe),
            };
            answers.extend((!answer.is_empty()).then_some(answer));
        }
        Ok(answers)
    }

    /// Lets time pass until nothing moves; false when it never does.
    pub fn settle(&mut self, mut observe: impl FnMut(Played<'_>)) -> bool {
        for _ in 0..PATIENCE_SEGMENTS {
            self.step(&mut observe);
            if !self.board.front.operation_pending() {
                return true;
            }
        }
        false
    }
}
