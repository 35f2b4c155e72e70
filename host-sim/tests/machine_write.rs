//! Machine files that the program writes are read back as the same machine.

mod stage;

use host_sim::machine::{ErrorName, Function, Machine, to_toml, to_toml_with};
use stage::{Dice, GOLDEN, golden};

#[test]
fn what_was_read_is_written_and_read_as_the_same_machine() {
    let shipped = ["bench", "long-lever", "paper"].map(|name| {
        let path = format!("{}/machines/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        Machine::load(path.as_ref()).expect(name)
    });
    for machine in shipped.into_iter().chain(GOLDEN.map(|name| golden(name).0)) {
        let text = to_toml(&machine);
        assert_eq!(Machine::parse(&text).expect(&text), machine, "{text}");
        assert_eq!(to_toml(&Machine::parse(&text).unwrap()), text);
    }
}

#[test]
fn any_machine_keeps_its_numbers_to_the_last_digit_but_one() {
    let mut dice = Dice::new(8);
    for _ in 0..100 {
        let mut machine = dice.stage().machine;
        machine.mounts.chip.rotation_rad = [0; 3].map(|_| dice.between(-0.02, 0.02));
        machine.mounts.fibre.offset_nm = [0; 3].map(|_| dice.between(-1e6, 1e6));
        let text = to_toml(&machine);
        let read = Machine::parse(&text).expect(&text);
        assert_eq!((read.statics, read.mounts.chip, read.order), (machine.statics, machine.mounts.chip, machine.order));
        let close = |a: f64, b: f64| (a - b).abs() <= 4e-16 * a.abs();
        for (a, b) in read.drives.iter().zip(&machine.drives) {
            assert!(a.step == b.step && a.backlash == b.backlash);
            assert!(close(a.travel[0], b.travel[0]) && close(a.switches[1], b.switches[1]) && close(a.jerk, b.jerk));
        }
        assert!((0..3).all(|c| close(read.fibre_point_nm[c], machine.fibre_point_nm[c])));
        // from then on nothing changes any more
        assert_eq!(Machine::parse(&to_toml(&read)).unwrap(), read);
    }
}

#[test]
fn kinematic_errors_of_every_form_are_written() {
    let mut machine = Machine::paper();
    for (n, name) in ErrorName::all().enumerate().filter(|(n, _)| n % 5 == 0) {
        let reach = if name.axis.is_rotary() { 3.0 } else { 4000.0 };
        let table = vec![[-reach, 1e-7], [reach, 3e-6]];
        let all = Function::new(vec![0.0, 1.5e-9], table, vec![[reach / 8.0, 0.0, 2.5e-6]]).unwrap();
        machine.kinematic.set(name, if n % 2 == 0 { all } else { Function::constant(1e-5) });
    }
    let text = to_toml(&machine);
    assert_eq!(Machine::parse(&text).expect(&text), machine, "{text}");
}

#[test]
fn numbers_are_written_as_a_person_would() {
    let text = to_toml(&Machine::paper());
    for line in ["travel_um = [-5000.0, 5000.0]", "travel_deg = [-3.0, 3.0]", "S_ZX = 5e-5", "max_jerk_deg_s3 = 400.0"]
    {
        assert!(text.lines().any(|written| written == line), "{line} in {text}");
    }
}

#[test]
fn comments_stand_on_top_and_behind_their_keys() {
    let note = |key: &str| (key == "axes.X.backlash_nm").then(|| "+- 5".to_string());
    let text = to_toml_with(&Machine::paper(), &["first\nsecond".into()], note);
    assert!(text.starts_with("# first\n# second\nname = \"paper\"\n"), "{text}");
    assert!(text.contains("backlash_nm = 300.0  # +- 5\n") && text.matches("+- 5").count() == 1);
    assert_eq!(Machine::parse(&text).unwrap(), Machine::paper());
}
