//! The table.

use super::{Command as C, Entry, Form, Kind, Param, arity};
use crate::error::ErrorNumber::{self, *};
use crate::settings::{BAUD_MAX, BAUD_MIN};

const fn param(name: &'static str, kind: Kind) -> Param {
    Param { name, kind, optional: false, extremes: false }
}

/// A parameter that takes `MIN|MAX|DEF` too.
const fn value(name: &'static str, kind: Kind) -> Param {
    Param { name, kind, optional: false, extremes: true }
}

const NONE: &[Param] = &[];
const EXTREME: &[Param] = &[Param { name: "which", kind: Kind::Extreme, optional: true, extremes: false }];
const BYTE: &[Param] = &[param("mask", Kind::Integer(0, 255))];
const WORD: &[Param] = &[param("mask", Kind::Integer(0, 65_535))];
const SWITCH: &[Param] = &[value("state", Kind::Boolean)];
const COORDINATE: &[Param] = &[param("x", Kind::Coordinate)];
const COORDINATE_SETTING: &[Param] = &[value("x", Kind::Coordinate)];
const VELOCITY: &[Param] = &[value("v", Kind::Rate(1))];
const STEPS: &[Param] = &[value("steps", Kind::Integer(0, 1 << 20))];
const POSE: &[Param] = &[param("x,y,z,a,b,g", Kind::Pose)];
/// Where `*SAV` saves: there is one place.
const PLACE: &[Param] = &[Param { name: "place", kind: Kind::Integer(0, 0), optional: true, extremes: false }];
const PIVOT: Param = param("k", Kind::Integer(0, 7));

/// What a move of a pose or an axis is refused for; relative ones and jogs need no homing.
const MOVE_ERRORS: &[ErrorNumber] = &[
    InitIgnored,
    SettingsConflict,
    DataOutOfRange,
    NotHomed,
    LimitSwitch,
    EmergencyStop,
    Moving,
    AxisDisabled,
    PositionUncertain,
];
const RELATIVE_ERRORS: &[ErrorNumber] =
    &[InitIgnored, SettingsConflict, DataOutOfRange, LimitSwitch, EmergencyStop, Moving, AxisDisabled];
const STANDSTILL: &[ErrorNumber] = &[DataOutOfRange, Moving];
const LEVEL: &[Param] = &[value("level", Kind::Choice(&["LOW", "HIGH"]))];
const PIVOT_ERRORS: &[ErrorNumber] = &[DataOutOfRange, SettingsConflict, NoCalibration, Moving];
const SWITCH_ERRORS: &[ErrorNumber] = &[DataOutOfRange, NoCalibration, Moving];
const NO_CALIBRATION: &[ErrorNumber] = &[NoCalibration];
const STORAGE_ERRORS: &[ErrorNumber] = &[DataOutOfRange, StorageFault, Moving];
const RECALL_ERRORS: &[ErrorNumber] = &[DataOutOfRange, SettingsConflict, StorageFault, Moving];
const RANGE: &[ErrorNumber] = &[DataOutOfRange];
const SCAN_ERRORS: &[ErrorNumber] =
    &[InitIgnored, SettingsConflict, DataOutOfRange, LimitSwitch, EmergencyStop, Moving, AxisDisabled, ScanFailed];
const DEFINE_ERRORS: &[ErrorNumber] = &[InitIgnored, SettingsConflict, DataOutOfRange];
const SENSE_ERRORS: &[ErrorNumber] = &[InitIgnored, DataOutOfRange];
const SCAN: Param = param("id", Kind::Integer(0, 7));
const CHANNEL: Param = param("ch", Kind::Integer(1, 2));
const AXIS: Param = param("axis", Kind::AxisNumber);
const SECOND_AXIS: Param = param("axis2", Kind::AxisNumber);
const SCAN_RANGE: Param = param("range", Kind::Span);
const PITCH: Param = param("pitch", Kind::Span);
const STEP: Param = param("step", Kind::Span);
const LIGHT: Param = param("threshold", Kind::Level);
const THRESHOLD: Param = Param { optional: true, ..LIGHT };
const END: Param =
    Param { name: "end", kind: Kind::Choice(&["PEAK", "STAY", "STARt", "FIRSt"]), optional: true, extremes: false };
const FLANK: Param =
    Param { name: "flank", kind: Kind::Choice(&["POSitive", "NEGative"]), optional: true, extremes: false };

#[cfg_attr(target_os = "none", expect(unused_variables))]
const fn entry(command: C, pattern: &'static str, form: Form, params: &'static [Param], help: &'static str) -> Entry {
    Entry {
        command,
        pattern,
        form,
        arity: [arity(params), (0, 0)],
        #[cfg(not(target_os = "none"))]
        params,
        #[cfg(not(target_os = "none"))]
        query_params: NONE,
        #[cfg(not(target_os = "none"))]
        range: "",
        #[cfg(not(target_os = "none"))]
        default: "",
        #[cfg(not(target_os = "none"))]
        errors: &[],
        #[cfg(not(target_os = "none"))]
        help,
        #[cfg(not(target_os = "none"))]
        example: pattern,
    }
}

const fn query(command: C, pattern: &'static str, help: &'static str) -> Entry {
    entry(command, pattern, Form::Query, NONE, help)
}

const fn set(command: C, pattern: &'static str, params: &'static [Param], help: &'static str) -> Entry {
    entry(command, pattern, Form::Set, params, help)
}

/// A register: query and set without `MIN|MAX|DEF`.
const fn mask(command: C, pattern: &'static str, params: &'static [Param], help: &'static str) -> Entry {
    entry(command, pattern, Form::Both, params, help).errors(RANGE)
}

/// A setting: its query takes `MIN|MAX|DEF`.
const fn setting(command: C, pattern: &'static str, params: &'static [Param], help: &'static str) -> Entry {
    entry(command, pattern, Form::Both, params, help).errors(RANGE).asked_with(EXTREME)
}

impl Entry {
    /// Parameters of the query.
    const fn asked_with(self, query_params: &'static [Param]) -> Self {
        Entry {
            arity: [self.arity[0], arity(query_params)],
            #[cfg(not(target_os = "none"))]
            query_params,
            ..self
        }
    }
}

/// What the manual says.
#[cfg(not(target_os = "none"))]
impl Entry {
    const fn range(self, range: &'static str, default: &'static str) -> Self {
        Entry { range, default, ..self }
    }

    const fn errors(self, errors: &'static [ErrorNumber]) -> Self {
        Entry { errors, ..self }
    }

    const fn example(self, example: &'static str) -> Self {
        Entry { example, ..self }
    }
}

#[cfg(target_os = "none")]
impl Entry {
    const fn range(self, _: &'static str, _: &'static str) -> Self {
        self
    }

    const fn errors(self, _: &'static [ErrorNumber]) -> Self {
        self
    }

    const fn example(self, _: &'static str) -> Self {
        self
    }
}

/// Every command, in the order of the manual.
pub const TABLE: &[Entry] = &[
    query(C::Identify, "*IDN", "Maker, model, serial number, version.").example("*IDN?"),
    set(C::Reset, "*RST", NONE, "Aborts, moves nothing, sets every default; keeps calibration, home, limits and BAUD."),
    set(C::ClearStatus, "*CLS", NONE, "Clears events and the error queue of this link."),
    mask(C::EventEnable, "*ESE", BYTE, "Standard event status enable.").range("0..255", "0").example("*ESE 60"),
    query(C::EventStatus, "*ESR", "Standard event status; reading clears it.").example("*ESR?"),
    mask(C::ServiceEnable, "*SRE", BYTE, "Service request enable.").range("0..255", "0").example("*SRE 16"),
    query(C::StatusByte, "*STB", "Status byte.").example("*STB?"),
    entry(C::OperationComplete, "*OPC", Form::Both, NONE, "Tells when all motion, scanning and take-up have ended.")
        .example("*OPC?"),
    set(C::Wait, "*WAI", NONE, "Waits until all motion, scanning and take-up have ended."),
    set(C::Trigger, "*TRG", NONE, "Begins the scan or the recording that waits for it.")
        .errors(&[TriggerIgnored, EmergencyStop])
        .example("*TRG"),
    query(C::SelfTest, "*TST", "Self-test: 0 passed.").example("*TST?"),
    query(C::Options, "*OPT", "Options fitted.").example("*OPT?"),
    set(C::Save, "*SAV", PLACE, "Saves settings, calibration and where the motors stand; goes on when they are saved.")
        .errors(STORAGE_ERRORS)
        .example("*SAV"),
    set(C::Recall, "*RCL", PLACE, "Puts the saved settings and calibration in force; moves nothing.")
        .errors(RECALL_ERRORS)
        .example("*RCL"),
    query(C::ErrorNext, "SYSTem:ERRor[:NEXT]", "Takes the oldest error.").example("SYST:ERR?"),
    query(C::ErrorCount, "SYSTem:ERRor:COUNt", "Errors in the queue.").example("SYST:ERR:COUN?"),
    query(C::ErrorAll, "SYSTem:ERRor:ALL", "Takes all errors.").example("SYST:ERR:ALL?"),
    query(C::Version, "SYSTem:VERSion", "SCPI version.").example("SYST:VERS?"),
    query(C::HelpHeaders, "SYSTem:HELP:HEADers", "All headers, as a block.").example("SYST:HELP:HEAD?"),
    query(C::TimeTick, "SYSTem:TIME:TICK", "Ticks played since power-up.").example("SYST:TIME:TICK?"),
    set(C::SystemPreset, "SYSTem:PRESet", NONE, "As *RST.").example("SYST:PRES"),
    setting(
        C::JogTimeout,
        "SYSTem:JOG:TIMeout",
        &[value("t", Kind::Time)],
        "A jog ends after this time without traffic on its link.",
    )
    .range("0.01..3600 s", "1 s")
    .example("SYST:JOG:TIM 500 MS"),
    set(C::SystemPark, "SYSTem:PARK", NONE, "Saves where the motors stand; the saved settings stay as they are.")
        .errors(STORAGE_ERRORS)
        .example("SYST:PARK"),
    setting(
        C::SerialBaud,
        "SYSTem:COMMunicate:SERial:BAUD",
        &[value("baud", Kind::Integer(BAUD_MIN as i64, BAUD_MAX as i64))],
        "Speed of the serial port, from when the answers of the message have left.",
    )
    .range("9600..1000000", "115200")
    .example("SYST:COMM:SER:BAUD 115200"),
    query(
        C::EmergencyStopState,
        "SYSTem:ESTop:STATe",
        "Emergency stop: 1 while it is latched, and 1 while its contact is open.",
    )
    .example("SYST:EST:STAT?"),
    set(
        C::EmergencyStopClear,
        "SYSTem:ESTop:CLEar",
        NONE,
        "Allows motion again after an emergency stop, once the contact is closed.",
    )
    .errors(&[EmergencyStop])
    .example("SYST:EST:CLE"),
    query(C::OperationEvent, "STATus:OPERation[:EVENt]", "Operation events; reading clears them.")
        .example("STAT:OPER?"),
    query(C::OperationCondition, "STATus:OPERation:CONDition", "Operation conditions.").example("STAT:OPER:COND?"),
    mask(C::OperationEnable, "STATus:OPERation:ENABle", WORD, "Operation events that sum up.")
        .range("0..65535, bit 15 stays 0", "0")
        .example("STAT:OPER:ENAB 256"),
    mask(C::OperationPositive, "STATus:OPERation:PTRansition", WORD, "Rising conditions that latch.")
        .range("0..65535, bit 15 stays 0", "32767")
        .example("STAT:OPER:PTR 256"),
    mask(C::OperationNegative, "STATus:OPERation:NTRansition", WORD, "Falling conditions that latch.")
        .range("0..65535, bit 15 stays 0", "0")
        .example("STAT:OPER:NTR 256"),
    query(C::OperationInstrumentEvent, "STATus:OPERation:INSTrument[:EVENt]", "Axes that began to move.")
        .example("STAT:OPER:INST?"),
    query(C::OperationInstrumentCondition, "STATus:OPERation:INSTrument:CONDition", "Axes that move.")
        .example("STAT:OPER:INST:COND?"),
    mask(C::OperationInstrumentEnable, "STATus:OPERation:INSTrument:ENABle", WORD, "Axis events that sum up.")
        .range("0..65535, bit 15 stays 0", "32767")
        .example("STAT:OPER:INST:ENAB 126"),
    mask(C::OperationInstrumentPositive, "STATus:OPERation:INSTrument:PTRansition", WORD, "Rising axes that latch.")
        .range("0..65535, bit 15 stays 0", "32767")
        .example("STAT:OPER:INST:PTR 126"),
    mask(C::OperationInstrumentNegative, "STATus:OPERation:INSTrument:NTRansition", WORD, "Falling axes that latch.")
        .range("0..65535, bit 15 stays 0", "0")
        .example("STAT:OPER:INST:NTR 126"),
    query(C::QuestionableEvent, "STATus:QUEStionable[:EVENt]", "Questionable events; reading clears them.")
        .example("STAT:QUES?"),
    query(C::QuestionableCondition, "STATus:QUEStionable:CONDition", "Questionable conditions.")
        .example("STAT:QUES:COND?"),
    mask(C::QuestionableEnable, "STATus:QUEStionable:ENABle", WORD, "Questionable events that sum up.")
        .range("0..65535, bit 15 stays 0", "0")
        .example("STAT:QUES:ENAB 512"),
    mask(C::QuestionablePositive, "STATus:QUEStionable:PTRansition", WORD, "Rising conditions that latch.")
        .range("0..65535, bit 15 stays 0", "32767")
        .example("STAT:QUES:PTR 512"),
    mask(C::QuestionableNegative, "STATus:QUEStionable:NTRansition", WORD, "Falling conditions that latch.")
        .range("0..65535, bit 15 stays 0", "0")
        .example("STAT:QUES:NTR 512"),
    query(C::QuestionableInstrumentEvent, "STATus:QUEStionable:INSTrument[:EVENt]", "Axes that became questionable.")
        .example("STAT:QUES:INST?"),
    query(C::QuestionableInstrumentCondition, "STATus:QUEStionable:INSTrument:CONDition", "Questionable axes.")
        .example("STAT:QUES:INST:COND?"),
    mask(C::QuestionableInstrumentEnable, "STATus:QUEStionable:INSTrument:ENABle", WORD, "Axis events that sum up.")
        .range("0..65535, bit 15 stays 0", "32767")
        .example("STAT:QUES:INST:ENAB 126"),
    mask(
        C::QuestionableInstrumentPositive,
        "STATus:QUEStionable:INSTrument:PTRansition",
        WORD,
        "Rising axes that latch.",
    )
    .range("0..65535, bit 15 stays 0", "32767")
    .example("STAT:QUES:INST:PTR 126"),
    mask(
        C::QuestionableInstrumentNegative,
        "STATus:QUEStionable:INSTrument:NTRansition",
        WORD,
        "Falling axes that latch.",
    )
    .range("0..65535, bit 15 stays 0", "0")
    .example("STAT:QUES:INST:NTR 126"),
    set(C::StatusPreset, "STATus:PRESet", NONE, "Enables and filters of this link as after power-up.")
        .example("STAT:PRES"),
    query(C::StatusAxis, "STATus:AXIS#[:CONDition]", "Conditions of an axis.").example("STAT:AXIS2?"),
    set(C::AxisMove, "AXIS#:MOVE[:ABSolute]", COORDINATE, "Moves an axis to a coordinate.")
        .errors(MOVE_ERRORS)
        .example("AXIS1:MOVE 125.5 UM"),
    set(
        C::AxisMoveRelative,
        "AXIS#:MOVE:RELative",
        &[param("dx", Kind::Displacement)],
        "Moves an axis by a distance from its target.",
    )
    .errors(RELATIVE_ERRORS)
    .example("AXIS1:MOVE:REL -10 STEP"),
    set(
        C::AxisMoveJog,
        "AXIS#:MOVE:JOG",
        &[param("v", Kind::Rate(1))],
        "Moves at constant velocity until STOP, a limit or a new jog; 0 ramps down.",
    )
    .range("+- the axis' VELocity", "")
    .errors(&[InitIgnored, DataOutOfRange, LimitSwitch, EmergencyStop, Moving, AxisDisabled])
    .example("AXIS4:MOVE:JOG 0.1 DEG/S"),
    set(C::AxisStop, "AXIS#:STOP[:DECelerate]", NONE, "Stops an axis within its limits.").example("AXIS1:STOP"),
    set(C::AxisStopImmediate, "AXIS#:STOP:IMMediate", NONE, "Stops at once, and all motors with it; see VEL:STAR.")
        .example("AXIS1:STOP:IMM"),
    set(C::Stop, "STOP", NONE, "Stops all axes within their limits."),
    set(C::Abort, "ABORt", NONE, "Stops everything at once; so does ! as the first byte of a line.").example("ABOR"),
    query(C::AxisPosition, "AXIS#:POSition", "Logical position of the words played so far.").example("AXIS1:POS?"),
    query(C::AxisPositionCommand, "AXIS#:POSition:COMMand", "Target; of a jog, where it is.")
        .example("AXIS1:POS:COMM?"),
    query(C::AxisPositionMotor, "AXIS#:POSition:MOTor", "Motor steps really played.").example("AXIS1:POS:MOT?"),
    set(C::AxisPositionSet, "AXIS#:POSition:SET", COORDINATE, "Says where the axis stands; it is homed then.")
        .errors(&[DataOutOfRange, Moving])
        .example("AXIS1:POS:SET 0"),
    setting(C::AxisVelocity, "AXIS#:VELocity", VELOCITY, "Wanted velocity of the logical axis.")
        .range("1 nm/s or nrad/s .. the motor's", "the motor's")
        .example("AXIS1:VEL 2 MM/S"),
    setting(C::AxisVelocityStart, "AXIS#:VELocity:STARt", VELOCITY, "An immediate stop above it makes 109.")
        .range("0 .. the motor's", "the motor's velocity")
        .example("AXIS1:VEL:STAR 100"),
    setting(C::AxisAcceleration, "AXIS#:ACCeleration", &[value("a", Kind::Rate(2))], "Wanted acceleration.")
        .range("1 um/s2 or urad/s2 .. the motor's", "the motor's")
        .example("AXIS1:ACC 20 MM/S2"),
    setting(C::AxisJerk, "AXIS#:JERK", &[value("j", Kind::Rate(3))], "Wanted jerk.")
        .range("1 um/s3 or urad/s3 .. the motor's", "the motor's")
        .example("AXIS1:JERK 200 MM/S3"),
    setting(
        C::AxisStepSize,
        "AXIS#:STEP:SIZE",
        &[value("size", Kind::StepSize)],
        "Size of a motor step; with a calibration it can only be asked.",
    )
    .range("2..65536 nm or nrad", "the calibration's, else 50 nm or 4000 nrad")
    .errors(&[DataOutOfRange, SettingsConflict, Moving])
    .example("AXIS1:STEP:SIZE 50 NM"),
    setting(C::AxisStepInvert, "AXIS#:STEP:INVert", SWITCH, "Inverts the sense of DIR.")
        .range("OFF|ON", "OFF")
        .errors(&[DataOutOfRange, Moving])
        .example("AXIS1:STEP:INV ON"),
    setting(
        C::AxisStepTiming,
        "AXIS#:STEP:TIMing",
        &[value("high", Kind::Time), value("low", Kind::Time), value("setup", Kind::Time), value("hold", Kind::Time)],
        "Pulse times that the driver needs; used in whole ticks of 1 us, rounded up.",
    )
    .range("0..32 us high and low, 0..128 us setup and hold", "1 us, 1 us, 2.5 us, 2.5 us")
    .errors(&[DataOutOfRange, SettingsConflict, Moving])
    .example("AXIS1:STEP:TIM 1 US,1 US,2.5 US,2.5 US"),
    setting(C::AxisEnable, "AXIS#:ENABle", SWITCH, "Switches the driver.")
        .range("OFF|ON", "OFF")
        .errors(&[DataOutOfRange, Moving, DriverFault])
        .example("AXIS1:ENAB ON"),
    setting(
        C::AxisEnablePolarity,
        "AXIS#:ENABle:POLarity",
        LEVEL,
        "Level of the enable line that switches the driver on.",
    )
    .range("LOW|HIGH", "LOW")
    .errors(STANDSTILL)
    .example("AXIS1:ENAB:POL LOW"),
    setting(C::AxisFaultPolarity, "AXIS#:FAULt:POLarity", LEVEL, "Level of the fault line that reports a fault.")
        .range("LOW|HIGH", "LOW: an open collector; the input is pulled up")
        .errors(STANDSTILL)
        .example("AXIS1:FAUL:POL LOW"),
    set(
        C::AxisHome,
        "AXIS#:HOME[:IMMediate]",
        NONE,
        "Homes the axis on a limit switch; see Homing. Only its own motor turns.",
    )
    .errors(&[
        InitIgnored,
        SettingsConflict,
        DataOutOfRange,
        NotHomed,
        LimitSwitch,
        EmergencyStop,
        Moving,
        AxisDisabled,
    ])
    .example("AXIS1:HOME"),
    setting(
        C::AxisHomeType,
        "AXIS#:HOME:TYPE",
        &[value("side", Kind::Choice(&["LOWer", "UPPer"]))],
        "The end of the travel at whose limit switch the axis is homed.",
    )
    .range("LOWer|UPPer", "LOWer")
    .errors(STANDSTILL)
    .example("AXIS1:HOME:TYPE LOW"),
    setting(C::AxisHomeVelocity, "AXIS#:HOME:VELocity", VELOCITY, "Velocity of the fast approach to the switch.")
        .range("1 nm/s or nrad/s .. the motor's", "a quarter of the motor's")
        .errors(STANDSTILL)
        .example("AXIS1:HOME:VEL 500"),
    setting(
        C::AxisHomeOffset,
        "AXIS#:HOME:OFFSet",
        COORDINATE_SETTING,
        "Where the motor stands once it is homed: the coordinate of the axis with the compensation off.",
    )
    .range("within +-2^29 nm or nrad", "the end of the travel on that side")
    .errors(STANDSTILL)
    .example("AXIS1:HOME:OFFS -5 MM"),
    query(C::AxisHomeState, "AXIS#:HOME:STATe", "1 when the axis is homed.").example("AXIS1:HOME:STAT?"),
    setting(
        C::AxisLimitSoftLower,
        "AXIS#:LIMit:SOFT:LOWer",
        COORDINATE_SETTING,
        "Lower logical limit, below the upper one.",
    )
    .range("within +-2^29 nm or nrad", "the travel")
    .example("AXIS1:LIM:SOFT:LOW -5 MM"),
    setting(
        C::AxisLimitSoftUpper,
        "AXIS#:LIMit:SOFT:UPPer",
        COORDINATE_SETTING,
        "Upper logical limit, above the lower one.",
    )
    .range("within +-2^29 nm or nrad", "the travel")
    .example("AXIS1:LIM:SOFT:UPP 5 MM"),
    setting(C::AxisLimitSoftState, "AXIS#:LIMit:SOFT:STATe", SWITCH, "Switches the logical limits.")
        .range("OFF|ON", "ON")
        .example("AXIS1:LIM:SOFT:STAT ON"),
    query(
        C::AxisLimitHard,
        "AXIS#:LIMit:HARD",
        "Limit switches, the lower and the upper one: 1 active, watched or not.",
    )
    .example("AXIS1:LIM:HARD?"),
    setting(
        C::AxisLimitHardPolarity,
        "AXIS#:LIMit:HARD:POLarity",
        LEVEL,
        "Level of the lines of active limit switches.",
    )
    .range("LOW|HIGH", "HIGH: normally closed to ground; a broken wire is active")
    .errors(STANDSTILL)
    .example("AXIS1:LIM:HARD:POL HIGH"),
    setting(
        C::AxisLimitHardState,
        "AXIS#:LIMit:HARD:STATe",
        SWITCH,
        "Whether the limit switches of the axis stop motion.",
    )
    .range("OFF|ON", "OFF")
    .errors(STANDSTILL)
    .example("AXIS1:LIM:HARD:STAT OFF"),
    setting(
        C::AxisBacklashMode,
        "AXIS#:BACKlash:MODE",
        &[value("mode", Kind::Choice(&["OFF", "REVersal", "UNIPos", "UNINeg"]))],
        "How the play of the motor is taken up.",
    )
    .range("OFF|REVersal|UNIPos|UNINeg", "REVersal")
    .errors(&[Moving])
    .example("AXIS1:BACK:MODE REV"),
    setting(
        C::AxisBacklashDistance,
        "AXIS#:BACKlash:DISTance",
        COORDINATE_SETTING,
        "Width of the play, used in whole steps.",
    )
    .range("0..1048576 steps", "the calibration's")
    .errors(&[DataOutOfRange, Moving])
    .example("AXIS1:BACK:DIST 2.5"),
    setting(C::AxisBacklashVelocity, "AXIS#:BACKlash:VELocity", VELOCITY, "Velocity reserved for take-up.")
        .range("1..50 % of the motor's", "10 % of the motor's")
        .errors(&[DataOutOfRange, Moving])
        .example("AXIS1:BACK:VEL 200"),
    setting(C::AxisBacklashDeadband, "AXIS#:BACKlash:DEADband", STEPS, "Retreat that does not turn the flank.")
        .range("0..1048576 steps", "1")
        .example("AXIS1:BACK:DEAD 2"),
    setting(C::AxisBacklashMargin, "AXIS#:BACKlash:MARGin", STEPS, "Overshoot beyond the play in UNIPos and UNINeg.")
        .range("0..1048576 steps", "10")
        .example("AXIS1:BACK:MARG 10"),
    set(
        C::AxisBacklashPreload,
        "AXIS#:BACKlash:PRELoad",
        &[param("side", Kind::Choice(&["POSitive", "NEGative"]))],
        "Moves through the play and back, so that the flank is known.",
    )
    .errors(&[SettingsConflict, DataOutOfRange, LimitSwitch, EmergencyStop, Moving, AxisDisabled])
    .example("AXIS1:BACK:PREL POS"),
    query(C::AxisBacklashOffset, "AXIS#:BACKlash:OFFSet", "Overlay in motor steps.").example("AXIS1:BACK:OFFS?"),
    query(C::AxisBacklashState, "AXIS#:BACKlash:STATe", "Flank of the motor: POS, NEG or UNKN.")
        .example("AXIS1:BACK:STAT?"),
    set(C::PoseMove, "POSE[:ABSolute]", POSE, "Moves all six axes to a pose.")
        .errors(MOVE_ERRORS)
        .example("POSE 0,0,0,0,0,0.5"),
    set(C::PoseRelative, "POSE:RELative", &[param("dx,dy,dz,da,db,dg", Kind::PoseDelta)], "Moves by six distances.")
        .errors(RELATIVE_ERRORS)
        .example("POSE:REL 1,0,0,0,0,0"),
    query(C::PoseQuery, "POSE", "The six logical positions of the words played so far.").example("POSE?"),
    query(C::PoseCheck, "POSE:CHECk", "Dry run: verdict, duration, six peak step rates, six flank changes.")
        .asked_with(POSE)
        .example("POSE:CHEC? 0,0,0,0,0,0.5"),
    setting(C::VelocityOverride, "VELocity", &[value("percent", Kind::Percent)], "Speed override of all motion.")
        .range("1..100 %", "100")
        .example("VEL 50"),
    mask(
        C::PivotDefine,
        "PIVot:DEFine",
        &[PIVOT, param("x,y,z", Kind::Point)],
        "A rotation centre in the array frame.",
    )
    .asked_with(&[PIVOT])
    .range("k 1..7; at most 60 mm from any rotary axis", "")
    .errors(PIVOT_ERRORS)
    .example("PIV:DEF 1,0,0,2 MM"),
    setting(
        C::PivotSelect,
        "PIVot:SELect",
        &[value("k", Kind::Integer(0, 7))],
        "Chooses the rotation centre; 0 is the calibration's own.",
    )
    .range("0..7", "0")
    .errors(PIVOT_ERRORS)
    .example("PIV:SEL 1"),
    query(C::PivotQuery, "PIVot", "The rotation centre in use: number and x, y, z.")
        .errors(NO_CALIBRATION)
        .example("PIV?"),
    mask(
        C::CompareDefine,
        "OUTPut:PCOMpare",
        &[
            param("axis", Kind::Integer(1, 6)),
            param("start", Kind::Coordinate),
            param("step", Kind::Coordinate),
            param("count", Kind::Integer(0, 65_535)),
        ],
        "Pulses of the trigger output, one after the other, where the axis passes start, start + step, ...; count 0: off.",
    )
    .range("axis 1..6; count 0..65535; steps that take the axis two pulse times or more at its VELocity", "1,0,0,0")
    .errors(&[DataOutOfRange, Moving])
    .example("OUTP:PCOM 1,-50,0.5,201"),
    query(C::CompareCount, "OUTPut:PCOMpare:COUNt", "Pulses of the position compare in the words played so far.")
        .example("OUTP:PCOM:COUN?"),
    setting(C::CompensationState, "COMPensation:STATe", SWITCH, "Switches all compensation.")
        .range("OFF|ON", "ON")
        .errors(SWITCH_ERRORS)
        .example("COMP:STAT ON"),
    setting(C::CompensationCouplingState, "COMPensation:COUPling:STATe", SWITCH, "Switches the coupling.")
        .range("OFF|ON", "ON")
        .errors(SWITCH_ERRORS)
        .example("COMP:COUP:STAT ON"),
    setting(C::CompensationPivotState, "COMPensation:PIVot:STATe", SWITCH, "Switches the rotation centre.")
        .range("OFF|ON", "ON")
        .errors(SWITCH_ERRORS)
        .example("COMP:PIV:STAT ON"),
    setting(C::CompensationBacklashState, "COMPensation:BACKlash:STATe", SWITCH, "Switches the backlash overlay.")
        .range("OFF|ON", "ON")
        .errors(SWITCH_ERRORS)
        .example("COMP:BACK:STAT ON"),
    set(C::CompensationLoad, "COMPensation:LOAD", &[param("block", Kind::Block)], "Takes a calibration block.")
        .errors(&[InvalidBlockData, DataOutOfRange, SettingsConflict, DataCorrupt, Moving])
        .example("COMP:LOAD #13abc"),
    query(C::CompensationData, "COMPensation:DATA", "The calibration block.")
        .errors(NO_CALIBRATION)
        .example("COMP:DATA?"),
    query(C::CompensationCrc, "COMPensation:CRC", "CRC-32 of the calibration block.")
        .errors(NO_CALIBRATION)
        .example("COMP:CRC?"),
    query(C::CompensationName, "COMPensation:NAME", "Name of the machine.")
        .errors(NO_CALIBRATION)
        .example("COMP:NAME?"),
    query(C::SensePower, "SENSe#:POWer", "Mean of the latest AVERage samples of a power input, in dBm or W.")
        .example("SENS1:POW?"),
    setting(C::SenseRange, "SENSe#:RANGe", &[value("level", Kind::Level)], "Level above which the meter is saturated.")
        .range("one step of a conversion to full scale", "full scale, 3.3 V")
        .errors(SENSE_ERRORS)
        .example("SENS1:RANG DEF"),
    setting(C::SenseAverage, "SENSe#:AVERage", &[value("n", Kind::Integer(1, 256))], "Samples of a mean, 256 us each.")
        .range("1..256", "16")
        .errors(SENSE_ERRORS)
        .example("SENS1:AVER 4"),
    mask(C::SenseInput, "SENSe#:INPut", &[param("meter", Kind::Meter)], "What the voltage of the input means.")
        .range("to 1000 W/V, or to 100 dB/V", "LINear, 0.001 W/V")
        .errors(SENSE_ERRORS)
        .example("SENS1:INP LIN,0.0005"),
    setting(
        C::SenseScale,
        "SENSe#:SCALe",
        &[value("scale", Kind::Choice(&["LOGarithmic", "LINear"]))],
        "Answers of POWer? in dBm or in W.",
    )
    .range("LOGarithmic|LINear", "LOGarithmic")
    .errors(SENSE_ERRORS)
    .example("SENS1:SCAL LOG"),
    setting(C::SenseDelay, "SENSe#:DELay", &[value("t", Kind::Time)], "By how much the meter is late.")
        .range("0..0.1 s", "0")
        .errors(SENSE_ERRORS)
        .example("SENS1:DEL 0.5 MS"),
    mask(
        C::ScanLine,
        "SCAN:DEFine:LINE",
        &[SCAN, CHANNEL, AXIS, SCAN_RANGE, PITCH, THRESHOLD, END, FLANK],
        "A line about where the stage stands, sampled in motion on one flank.",
    )
    .asked_with(&[SCAN])
    .errors(DEFINE_ERRORS)
    .example("SCAN:DEF:LINE 0,1,1,20,0.05,-60,STAR"),
    mask(
        C::ScanRaster,
        "SCAN:DEFine:RASTer",
        &[
            SCAN,
            CHANNEL,
            AXIS,
            SECOND_AXIS,
            SCAN_RANGE,
            param("range2", Kind::Span),
            PITCH,
            STEP,
            THRESHOLD,
            END,
            FLANK,
        ],
        "Parallel lines, range2 wide, a step of the second axis apart.",
    )
    .asked_with(&[SCAN])
    .range("64 lines", "")
    .errors(DEFINE_ERRORS)
    .example("SCAN:DEF:RAST 1,1,1,2,20,20,0.5,2,-60,PEAK"),
    mask(
        C::ScanSpiral,
        "SCAN:DEFine:SPIRal",
        &[SCAN, CHANNEL, AXIS, SECOND_AXIS, SCAN_RANGE, PITCH, STEP, LIGHT, END],
        "A square spiral outwards, its turns a step apart, sampled in motion.",
    )
    .asked_with(&[SCAN])
    .range("64 turns", "")
    .errors(DEFINE_ERRORS)
    .example("SCAN:DEF:SPIR 2,1,1,2,20,0.5,4,-50,FIRS"),
    mask(
        C::ScanHill,
        "SCAN:DEFine:HILL",
        &[
            SCAN,
            CHANNEL,
            param("axes", Kind::AxisList),
            SCAN_RANGE,
            STEP,
            param("least", Kind::Span),
            param("patience", Kind::Integer(1, 100)),
            THRESHOLD,
            END,
        ],
        "Steps upwards on up to three axes, halved down to the least one.",
    )
    .asked_with(&[SCAN])
    .errors(DEFINE_ERRORS)
    .example("SCAN:DEF:HILL 3,1,(@1,2),20,1,0.1,1,-60,PEAK"),
    mask(
        C::ScanParabola,
        "SCAN:DEFine:PARabola",
        &[SCAN, CHANNEL, AXIS, SCAN_RANGE, param("points", Kind::Integer(5, 101)), THRESHOLD, END, FLANK],
        "Points about where the stage stands, measured at rest on one flank.",
    )
    .asked_with(&[SCAN])
    .errors(DEFINE_ERRORS)
    .example("SCAN:DEF:PAR 4,1,1,4,5,-60,PEAK"),
    set(C::ScanStart, "SCAN:STARt", &[SCAN], "Starts a scan, or lets it wait for its trigger.")
        .errors(SCAN_ERRORS)
        .example("SCAN:STAR 0"),
    set(C::ScanStop, "SCAN:STOP", NONE, "Stops the scan; it can go on.").example("SCAN:STOP"),
    set(C::ScanContinue, "SCAN:CONTinue", NONE, "Goes on with a stopped scan: its line or point is repeated.")
        .errors(SCAN_ERRORS)
        .example("SCAN:CONT"),
    query(C::ScanState, "SCAN:STATe", "IDLE, TRIG (waits for it), MOV, SAMP or STOP, and the number of the scan.")
        .example("SCAN:STAT?"),
    query(
        C::ScanResult,
        "SCAN:RESult",
        "Status word, samples, peak power; of each axis: peak, its standard uncertainty, and where it ended.",
    )
    .asked_with(&[SCAN])
    .errors(DEFINE_ERRORS)
    .example("SCAN:RES? 0"),
    mask(
        C::TraceConfigure,
        "TRACe:CONFigure",
        &[
            param("source", Kind::Choice(&["SAMPle", "SCAN"])),
            Param { name: "n", kind: Kind::Integer(1, 65_536), optional: true, extremes: false },
        ],
        "What is recorded: every n-th sample, of all or of those that a scan uses. Ends a recording.",
    )
    .range("", "SAMPle, 1")
    .example("TRAC:CONF SAMP,1"),
    set(C::TraceArm, "TRACe:ARM", NONE, "Begins a recording, or lets it wait for its trigger.")
        .errors(&[InitIgnored])
        .example("TRAC:ARM"),
    query(C::TracePoints, "TRACe:POINts", "Records that are kept, 1024 at most.").example("TRAC:POIN?"),
    query(C::TraceData, "TRACe:DATA", "Records: tick in us, six motor counts, power of both inputs in dBm.")
        .asked_with(&[param("first", Kind::Integer(0, 1023)), param("count", Kind::Integer(1, 1024))])
        .range("count: as many as there are; packed 113", "")
        .errors(RANGE)
        .example("TRAC:DATA? 0,1"),
    setting(
        C::Format,
        "FORMat",
        &[value("form", Kind::Choice(&["ASCii", "PACKed"]))],
        "How TRACe:DATA? answers: text, or a block.",
    )
    .range("ASCii|PACKed", "ASCii")
    .example("FORM ASC"),
    setting(
        C::TriggerSource,
        "TRIGger:SOURce",
        &[value("source", Kind::Choice(&["IMMediate", "BUS", "EXTernal"]))],
        "What begins a scan or a recording: nothing more, or *TRG. The board has no input for EXTernal.",
    )
    .range("IMMediate|BUS", "IMMediate")
    .example("TRIG:SOUR IMM"),
    query(C::CompensationMatrix, "COMPensation:MATRix", "D^-1 and W^-1, row by row.")
        .errors(NO_CALIBRATION)
        .example("COMP:MATR?"),
];
