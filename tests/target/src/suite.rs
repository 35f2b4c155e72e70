//! The scripts, the calibration blocks that they name, and the records that every build must give.

/// A script of the suite.
#[derive(Clone, Copy, Debug)]
pub struct Script {
    /// Its file name without `.txt`.
    pub name: &'static str,
    /// Its text.
    pub text: &'static str,
}

macro_rules! scripts {
    ($($name:literal)*) => {
        &[$(Script { name: $name, text: include_str!(concat!("../../golden/scripts/", $name, ".txt")) }),*]
    };
}

/// All scripts of `tests/golden/scripts`, in the order of [`WORDS`].
pub const SCRIPTS: &[Script] = scripts! {
    "one-axis"
    "poses"
    "jogs"
    "retargets"
    "stops"
    "aborts"
    "loads"
    "switches"
    "pivots"
    "reversals"
    "preload"
    "positions"
    "slow-drivers"
    "top-speed"
};

/// `tests/golden/words.txt`: the record of each script, and comments.
pub const WORDS: &str = include_str!("../../golden/words.txt");

/// What `tests/golden/words.txt` begins with.
pub const HEADER: &str = "\
# What every build must play and answer. Made by `cargo run -p target-tests --bin golden -- --write`.
# Script, segments of 256 us, steps of motors X Y Z alpha beta gamma, hash of all words, hash of all answers.
";

/// Machines by name, and their calibration blocks as `host-sim calibrate` makes them.
pub const BLOCKS: &[(&str, &[u8])] = &[
    ("paper", include_bytes!("../../golden/blocks/paper.cal")),
    ("long-lever", include_bytes!("../../golden/blocks/long-lever.cal")),
    ("bench", include_bytes!("../../golden/blocks/bench.cal")),
];

/// The calibration block of a machine.
pub fn block(machine: &str) -> Option<&'static [u8]> {
    BLOCKS.iter().find(|(name, _)| *name == machine).map(|(_, block)| *block)
}
