//! Scripts of the golden suite: one step a line.
//!
//! | Line | Meaning |
//! |---|---|
//! | `# text` | a comment |
//! | `@machine NAME` | power-up with that machine's calibration as if saved, enabled and homed at 0 |
//! | `@cold NAME` | power-up with that machine's calibration as if saved, nothing enabled, not homed |
//! | `@wait N` | N segments of 256 us pass |
//! | `@rest` | time passes until nothing moves and nothing is about to |
//! | `@tick K` | from now on an immediate stop comes after K words of the segment that then plays |
//! | `@load NAME` | `COMP:LOAD` with the calibration block of that machine |
//! | `= TEXT` | the answer to the line before is TEXT; time passes until it is there |
//! | anything else | a message for the controller |

use stage_controller::units::SEGMENT_TICKS;

/// One step of a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step<'a> {
    /// Power-up with the calibration of a machine.
    PowerUp {
        /// Which one.
        machine: &'a str,
        /// Neither enabled nor homed.
        cold: bool,
    },
    /// Time passes, segments.
    Wait(u32),
    /// Time passes until everything stands.
    Rest,
    /// Words of its segment that an immediate stop lets play.
    Tick(u16),
    /// The calibration block of this machine is sent.
    Load(&'a str),
    /// What the message before must have answered.
    Expect(&'a str),
    /// A message.
    Message(&'a str),
}

impl<'a> Step<'a> {
    /// The step that a line says; none for an empty line or a comment.
    ///
    /// # Errors
    /// The line is no step.
    pub fn parse(line: &'a str) -> Result<Option<Self>, Unreadable> {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            return Ok(None);
        }
        if let Some(answer) = line.strip_prefix('=') {
            return Ok(Some(Step::Expect(answer.trim())));
        }
        let Some(directive) = line.strip_prefix('@') else {
            return Ok(Some(Step::Message(line)));
        };
        let (name, value) = directive.split_once(' ').unwrap_or((directive, ""));
        let value = value.trim();
        let step = match name {
            "machine" if !value.is_empty() => Step::PowerUp { machine: value, cold: false },
            "cold" if !value.is_empty() => Step::PowerUp { machine: value, cold: true },
            "wait" => Step::Wait(value.parse().map_err(|_| Unreadable)?),
            "rest" if value.is_empty() => Step::Rest,
            "tick" => {
                Step::Tick(value.parse().ok().filter(|tick| usize::from(*tick) <= SEGMENT_TICKS).ok_or(Unreadable)?)
            }
            "load" if !value.is_empty() => Step::Load(value),
            _ => return Err(Unreadable),
        };
        Ok(Some(step))
    }
}

/// A line that is no step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unreadable;
