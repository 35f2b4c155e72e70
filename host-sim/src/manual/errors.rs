//! The list of errors.

use stage_controller::error::ErrorNumber;
use std::fmt::Write;

/// When an error comes; none for a number that the manual does not know.
fn when(number: ErrorNumber) -> Option<&'static str> {
    use ErrorNumber::*;
    Some(match number {
        InvalidCharacter => "a byte that is not ASCII in a header",
        SyntaxError => "`::`, a stray comma or parenthesis",
        DataTypeError => "text where a number belongs, NaN, a word that is not in the list",
        ParameterNotAllowed => "one parameter too many",
        MissingParameter => "a parameter is missing",
        UndefinedHeader => "no such command, or not in this form",
        HeaderSuffixOutOfRange => "an axis or a power input that does not exist",
        ExponentTooLarge => "an exponent beyond 32000",
        InvalidSuffix => "a wrong unit",
        InvalidStringData => "a string without its end",
        InvalidBlockData => "a block that is too short, too long, or that pauses for two seconds",
        TriggerIgnored => "`*TRG` while neither a scan nor a trace waits for it",
        InitIgnored => "an axis is being homed, a scan or a trace runs",
        SettingsConflict => {
            "a calibration block of another version or shape, a step rate above what the pulse timing allows, \
             a pivot that is not defined, a step size while a calibration gives it, a move too slow to be planned, \
             homing with limit switches that are not watched, `*RCL` with nothing saved, a scan that is not defined or of \
             another kind, a climb whose step the play of a motor swallows; the text names axis, step and the least one \
             that works"
        }
        DataOutOfRange => "a value or a move beyond a limit; the text names the axis and the value",
        DataCorrupt => "the CRC of a calibration block is wrong",
        StorageFault => "settings could not be saved or read; what was saved before is still there",
        SystemError => "an answer that is too long",
        QueueOverflow => "more than 16 errors; the oldest are kept",
        FramingError => "a damaged byte on the serial port, most often a wrong baud rate; the message is dropped",
        InputBufferOverrun => "a message longer than 512 bytes, or bytes that came faster than they could be taken",
        GetNotAllowed => "on a bus: a trigger in the middle of a message",
        QueryInterrupted => "on a bus: something was sent before the answer was read; the answer is dropped",
        QueryUnterminated => "on a bus: an answer was read and nothing had been asked, or not to the end",
        QueryDeadlocked => "kept; a message is executed when all of it is there, so that nothing can deadlock",
        QueryAfterIndefinite => "on a bus: a query behind `*IDN?` or `*OPT?` in the same message",
        NotHomed => "`POSE` or `AXIS<n>:MOVE` before the axes are homed; homing did not find its switch",
        LimitSwitch => {
            "a limit switch stopped the motors, or a move leads towards an active one; the text names axis and switch"
        }
        EmergencyStop => "the emergency stop was opened, or is still latched or open",
        StepDeadline => "steps could not be made in time, or the step output failed: all motors were stopped",
        SettingsLost => "saved settings could not be read at the start; once on every link, and QUEStionable bit 8",
        Clock => "the crystal does not run",
        WatchdogRestart => "the watchdog restarted the controller",
        DriverFault => "a driver reports a fault: it is disabled, and not enabled before the fault has gone",
        ScanFailed => {
            "no light above the threshold, no maximum within the range, a saturated input, or no samples; the text says \
             which, and the chapter on scans where the stage then stands"
        }
        Moving => "the command needs standstill",
        NoCalibration => "a part of the compensation is switched on or asked for with no calibration loaded",
        AxisDisabled => "a motor that the move would step is disabled",
        PositionUncertain => {
            "an immediate stop began above `VEL:STAR`, or the driver failed: the count is exact, the motor may have \
             slipped"
        }
        _ => return None,
    })
}

/// The table of errors.
pub fn table() -> String {
    let mut text = String::from("| Number | Text | When |\n|---|---|---|\n");
    for number in ErrorNumber::ALL {
        let when = when(*number).expect("every error is in the manual");
        let _ = writeln!(text, "| {} | {} | {when} |", number.code(), number.description());
    }
    text
}
