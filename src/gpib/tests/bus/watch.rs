//! Rules that hold at every edge.

use super::{Pull, Time};
use stage_gpib::lines::Lines;

// the times of the standard once more, so that a wrong constant of the crate is found
/// T1 of the first byte after ATN, three-state drivers.
const FIRST: Time = 1_100;
/// T1 of the others.
const NEXT: Time = 500;
/// t2.
const ATTENTION: Time = 200;
/// t4.
const CLEAR: Time = 100_000;

/// Names of the parties in the order of their pulls.
const NAMES: [&str; 3] = ["device", "instrument", "controller"];

/// Sees every edge.
#[derive(Default)]
pub struct Watch {
    lines: Lines,
    pulls: [Pull; 3],
    /// Since when ATN and IFC are true.
    attention: Option<Time>,
    clear: Option<Time>,
    /// Since when the device puts its present byte on the lines, and whether it is the first after ATN.
    stands: Time,
    first: bool,
    /// The device broke a time that only gates keep.
    pub late: Vec<String>,
    /// Bytes for which the device made DAV true.
    pub sourced: u64,
}

impl Watch {
    pub fn look(&mut self, now: Time, lines: Lines, pulls: [Pull; 3]) {
        let device = pulls[0];
        let data = Lines::DIO | Lines::EOI | Lines::DAV;

        if pulls.iter().filter(|pull| pull.drives_data).count() > 1 {
            let names: Vec<&str> =
                pulls.iter().zip(NAMES).filter(|(pull, _)| pull.drives_data).map(|(_, n)| n).collect();
            self.late.push(format!("{names:?} drive at once, {now} ns"));
        }
        for (pull, name) in pulls.iter().zip(NAMES) {
            assert!(pull.drives_data || !pull.lines.has(data) || name == "controller", "{name} pulls without drivers");
        }

        // t2, judged by what stood on the lines until now
        if self.attention.is_some_and(|since| now > since + ATTENTION) {
            if self.pulls[0].drives_data {
                self.late.push(format!("device drives data under ATN, {now} ns"));
            }
            if !self.pulls[0].lines.has(Lines::NDAC | Lines::NRFD) {
                self.late.push(format!("device takes no part under ATN, {now} ns"));
            }
        }
        // t4
        if self.clear.is_some_and(|since| now >= since + CLEAR) {
            assert!(!self.pulls[0].drives_data, "device drives data under IFC, {now} ns");
            let held = self.pulls[0].lines.has(Lines::NRFD | Lines::NDAC);
            assert!(self.attention.is_some() || !held, "device holds the handshake under IFC, {now} ns");
        }

        // T1, and data that stand still under DAV
        let before = self.pulls[0];
        if device.drives_data {
            let byte = |pull: Pull| pull.lines.only(Lines::DIO | Lines::EOI);
            if !before.drives_data || byte(before) != byte(device) {
                assert!(!before.lines.has(Lines::DAV) || !device.lines.has(Lines::DAV), "data change under DAV");
                self.stands = now;
            }
            if device.lines.has(Lines::DAV) && !before.lines.has(Lines::DAV) {
                let settle = if self.first { FIRST } else { NEXT };
                assert!(now - self.stands >= settle, "DAV {} ns after the data", now - self.stands);
                // once all have heard ATN or IFC they may hold again
                let quiet = !lines.has(Lines::ATN | Lines::IFC);
                assert!(!quiet || !self.lines.has(Lines::NRFD), "DAV without RFD, {now} ns");
                self.first = false;
                self.sourced += 1;
            }
        }

        if self.attention.is_some() && !lines.has(Lines::ATN) {
            self.first = true;
        }
        let since = |was: Option<Time>, line| if lines.has(line) { was.or(Some(now)) } else { None };
        self.attention = since(self.attention, Lines::ATN);
        self.clear = since(self.clear, Lines::IFC);
        self.lines = lines;
        self.pulls = pulls;
    }
}
