//! Settings that an older firmware has saved are still read.
//!
//! `tests/golden/settings/v<n>.bin` is a record as version n wrote it, `v<n>.txt` what a controller answers that starts
//! with it. A file that is there is never changed; a new version gets its own by
//!
//! ```text
//! cargo test -p host-sim --test settings_versions -- --ignored
//! ```

mod saving;

use host_sim::console::Console;
use host_sim::machine::Machine;
use host_sim::session::power_up;
use saving::{board_with, buffer, kept_settings, lines};
use stage_controller::controller::front::{Front, Start};
use stage_controller::store::record::{RECORD_VERSION, decode, inspect, seal};
use std::fs;
use std::path::PathBuf;

fn golden(version: u16, ending: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("../tests/golden/settings/v{version}.{ending}"))
}

/// What is asked beside the settings.
fn others() -> Vec<String> {
    let mut queries = vec!["COMP:CRC".to_owned(), "COMP:NAME".to_owned(), "PIV".to_owned()];
    queries.extend((1..=2).map(|n| format!("SENS{n}:INP")));
    queries.extend((1..=6).flat_map(|n| ["POS:MOT", "BACK:OFFS", "BACK:STAT"].map(|query| format!("AXIS{n}:{query}"))));
    queries
}

/// A controller that starts with a record.
fn started(bytes: &[u8]) -> Console {
    let saved = decode(bytes).expect("a record that is read");
    let mut front = Front::new();
    front.apply_record(&saved.record).expect("a record that can be in force");
    front.restore(&saved.standstill.expect("where the motors stood"), Start::PowerOn);
    Console::new(board_with(front))
}

#[test]
fn records_of_every_version_are_still_read() {
    for version in 1..=RECORD_VERSION {
        let bytes = fs::read(golden(version, "bin")).expect("a golden file for each version");
        assert_eq!(inspect(&bytes).map(|(version, _)| version), Some(version));
        let mut console = started(&bytes);
        let answers = fs::read_to_string(golden(version, "txt")).expect("its answers");
        assert!(answers.lines().count() > 80, "{}", answers.lines().count());
        for line in answers.lines() {
            let (query, answer) = line.split_once(' ').expect("a query and its answer");
            assert_eq!(console.line(&format!("{query}?"), |_| ()), answer, "version {version}, {query}");
        }
    }
}

/// The fields are read and written by one description: what it wrote then, it writes now.
#[test]
fn a_record_of_this_version_is_written_as_it_was() {
    let bytes = fs::read(golden(RECORD_VERSION, "bin")).expect("a golden file");
    let saved = decode(&bytes).expect("a record that is read");
    let (_, sequence) = inspect(&bytes).expect("a whole record");
    let mut buffer = buffer();
    let length =
        seal(&saved.record, &saved.standstill.expect("where the motors stood"), sequence, &mut buffer).unwrap();
    assert_eq!(&buffer[..length], &bytes[..]);
}

#[test]
#[ignore = "writes the golden file of a new version, once"]
fn write_the_golden_file_of_this_version() {
    let path = golden(RECORD_VERSION, "bin");
    assert!(!path.exists(), "{} is there and is never changed; raise RECORD_VERSION", path.display());
    let mut console = Console::new(board_with(power_up(&Machine::paper(), false).unwrap()));
    // every setting away from its default, where that is allowed
    for header in kept_settings() {
        for value in ["MIN", "MAX"] {
            if console.line(&format!("{header}?"), |_| ()) == console.line(&format!("{header}? DEF"), |_| ()) {
                console.line(&format!("{header} {value}"), |_| ());
            }
        }
    }
    for line in [
        "COMP:STAT ON;BACK:STAT ON;:VEL 87;:SYST:JOG:TIM 1.5;:SYST:COMM:SER:BAUD 921600",
        "AXIS1:BACK:MODE REV;MARG 7",
        "AXIS2:LIM:SOFT:LOW -1234.567;UPP 2345.678;:AXIS3:STEP:TIM 1 US,2 US,3 US,4 US",
        "AXIS4:BACK:MODE UNIP;:AXIS5:BACK:MODE UNIN;:AXIS6:BACK:MODE OFF",
        "PIV:DEF 3,1,-2.5,4000;:PIV:SEL 3",
        "SENS1:INP LIN,0.00025;RANG -20;AVER 7;DEL 1.5 MS;SCAL LIN;:SENS2:INP LOG,25.5,-71.25;RANG -12.5;AVER 200",
    ] {
        console.line(line, |_| ());
    }
    for axis in 1..=6 {
        let part = if axis < 4 { format!("{}.5", axis) } else { format!("0.0{axis}") };
        console.line(&format!("AXIS{axis}:VEL MAX;ACC MAX;JERK MAX;BACK:DIST {part};DEAD {axis}"), |_| ());
        console.line(&format!("AXIS{axis}:MOVE:REL 20 STEP;*OPC?"), |_| ());
        console.line(&format!("AXIS{axis}:MOVE:REL -{} STEP;*OPC?", 2 * axis - 2), |_| ());
    }
    // as late as this: the moves should not take for ever
    for axis in 1..=6 {
        let rate = if axis < 4 { format!("12{axis}.456") } else { format!("0.1{axis}") };
        console.line(&format!("AXIS{axis}:VEL {rate};ACC {rate};JERK {rate};:AXIS{axis}:VEL:STAR {rate}"), |_| ());
    }
    let mut buffer = buffer();
    let front = &console.board.front;
    let length = seal(&front.record(), &front.standstill_record(), 17, &mut buffer).unwrap();
    let mut again = started(&buffer[..length]);
    let queries: Vec<_> = kept_settings().into_iter().chain(others()).collect();
    fs::write(golden(RECORD_VERSION, "txt"), lines(&mut again, &queries).join("\n") + "\n").unwrap();
    fs::write(path, &buffer[..length]).unwrap();
}
