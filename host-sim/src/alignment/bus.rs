//! What the alignment PC has: two controllers that take messages and answer in lines, and a meter with a switch in
//! front of it.

use crate::bench_twin::{Collision, Sees, Side};

/// Why a message has no answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BusError {
    /// Nothing came back in time.
    #[error(
        "{side:?} controller: no answer to {message:?} within {seconds} s; is its link still there? It ends what it was \
         told last; connect again and begin anew"
    )]
    Silent {
        /// Whose.
        side: Side,
        /// What was asked.
        message: String,
        /// How long it was waited for.
        seconds: f64,
    },
    /// The controller refused.
    #[error("{side:?} controller: {message:?} raised {error}: {}", advice(error))]
    Refused {
        /// Whose.
        side: Side,
        /// What was sent.
        message: String,
        /// The entry of its error queue.
        error: String,
    },
    /// The answer is not what the message asks for.
    #[error("{side:?} controller: {message:?} was answered {answer:?}, which is not {wanted}")]
    Strange {
        /// Whose.
        side: Side,
        /// What was asked.
        message: String,
        /// What came.
        answer: String,
        /// What should have come.
        wanted: &'static str,
    },
    /// What should set something up does not.
    #[error("setup {message:?}: {reason}")]
    NoCommand {
        /// What was given.
        message: String,
        /// Why not.
        reason: &'static str,
    },
    /// What was learned of a stage cannot be loaded.
    #[error("{side:?} stage: {reason}")]
    Calibration {
        /// Whose.
        side: Side,
        /// What the calibration says.
        reason: String,
    },
    /// The bench is broken.
    #[error(transparent)]
    Collision(#[from] Collision),
}

/// What to do after an entry of the error queue: its number, and for 113 the reason.
fn advice(error: &str) -> &'static str {
    let number = error.split(',').next().unwrap_or_default();
    match number {
        "113" if error.contains("saturated") => "take power from the laser or put an attenuator before the meter",
        "113" if error.contains("no light") => {
            "see that the laser is on and the fibres whole, or begin nearer to the light"
        }
        "113" => "begin nearer to the light, or look farther",
        "-222" => {
            "the way leads beyond a limit; move the mount so that the light lies within the travel, or set the limits \
             (AXIS<n>:LIMit) farther"
        }
        "-113" | "-109" | "-108" | "-104" => "see the table of commands in COMMANDS.md for its words and parameters",
        "-213" | "104" => "wait until the scan or move of before has ended, or end it with ABORt",
        "101" | "109" => "home that axis (AXIS<n>:HOME)",
        "102" => "move that axis away from its switch, and the mount so that the light lies within the travel",
        "103" => "close the emergency stop and send SYSTem:ESTop:CLEar",
        "112" => "see to that driver, then AXIS<n>:ENABle ON",
        _ => "see the table of errors in COMMANDS.md",
    }
}

/// Two controllers and a meter, over messages alone.
pub trait Bus {
    /// Sends a message; its line feed is added.
    ///
    /// # Errors
    /// When the link is lost.
    fn send(&mut self, side: Side, message: &str) -> Result<(), BusError>;

    /// Sends a message that ends in block data (IEEE 488.2, 7.7.6).
    ///
    /// # Errors
    /// When the link is lost.
    fn send_block(&mut self, side: Side, message: &str, block: &[u8]) -> Result<(), BusError>;

    /// The next line that a controller answers, waited for this long (s).
    ///
    /// # Errors
    /// [`BusError::Silent`] after that time; a collision.
    fn line(&mut self, side: Side, message: &str, patience_s: f64) -> Result<String, BusError>;

    /// What a channel of the meter (0, 1) looks at from now on: an optical switch, of which the controllers know
    /// nothing.
    fn look(&mut self, channel: usize, sees: Sees);

    /// Time since the beginning, s.
    fn seconds(&self) -> f64;

    /// Lets time pass.
    ///
    /// # Errors
    /// A collision.
    fn pause(&mut self, seconds: f64) -> Result<(), BusError>;
}

/// Longest that an answer takes while nothing moves, s.
const AT_ONCE_S: f64 = 2.0;

/// A controller of a bus: messages checked by its error queue.
pub struct Controller<'a, B> {
    bus: &'a mut B,
    side: Side,
}

impl<'a, B: Bus> Controller<'a, B> {
    /// The controller of a side.
    pub fn new(bus: &'a mut B, side: Side) -> Self {
        Controller { bus, side }
    }

    pub(super) fn strange(&self, message: &str, answer: &str, wanted: &'static str) -> BusError {
        BusError::Strange { side: self.side, message: message.into(), answer: answer.into(), wanted }
    }

    /// Lets time pass.
    pub(super) fn pause(&mut self, seconds: f64) -> Result<(), BusError> {
        self.bus.pause(seconds)
    }

    /// Sends a message that nobody waits for.
    pub(super) fn send(&mut self, message: &str) -> Result<(), BusError> {
        self.bus.send(self.side, message)
    }

    /// The next line that comes, waited for this long (s).
    pub(super) fn answer(&mut self, message: &str, patience_s: f64) -> Result<String, BusError> {
        self.bus.line(self.side, message, patience_s)
    }

    /// Asks one question.
    ///
    /// # Errors
    /// Those of the bus.
    pub fn ask(&mut self, question: &str) -> Result<String, BusError> {
        self.bus.send(self.side, question)?;
        self.bus.line(self.side, question, AT_ONCE_S)
    }

    /// Asks for numbers, separated by commas; as many as come.
    ///
    /// # Errors
    /// Those of the bus; [`BusError::Strange`] for what is no number.
    pub fn numbers(&mut self, question: &str) -> Result<Vec<f64>, BusError> {
        let answer = self.ask(question)?;
        let numbers: Result<Vec<f64>, _> = answer.split([',', ';']).map(|word| word.trim().parse()).collect();
        numbers.map_err(|_| self.strange(question, &answer, "numbers"))
    }

    /// Sends a command, waits (this long, s) until all it has begun has ended, and looks into the error queue.
    ///
    /// # Errors
    /// Those of the bus; [`BusError::Refused`] with the first error.
    pub fn run(&mut self, command: &str, patience_s: f64) -> Result<(), BusError> {
        self.begin(command)?;
        self.end(command, patience_s)
    }

    /// Sends a message of somebody else's words, alone, and looks into the error queue by another one: an error in it may
    /// drop all that stands behind it.
    ///
    /// # Errors
    /// [`BusError::NoCommand`] for an empty message or a question; those of the bus; [`BusError::Refused`].
    pub fn set_up(&mut self, message: &str) -> Result<(), BusError> {
        if let Some(reason) = no_setup(message) {
            return Err(BusError::NoCommand { message: message.into(), reason });
        }
        self.bus.send(self.side, message)?;
        let asked = "*OPC?;:SYST:ERR?";
        self.bus.send(self.side, asked)?;
        self.checked(message, asked, SETUP_S)
    }

    /// Loads a calibration.
    ///
    /// # Errors
    /// Those of the bus; [`BusError::Refused`] for a block that the controller does not take.
    pub fn load(&mut self, block: &[u8]) -> Result<(), BusError> {
        self.bus.send_block(self.side, "COMP:LOAD ", block)?;
        self.run("*WAI", AT_ONCE_S)
    }

    /// Sends a command whose end is waited for later.
    pub(super) fn begin(&mut self, command: &str) -> Result<(), BusError> {
        self.bus.send(self.side, &watched(command))
    }

    /// Waits until a command that was begun has ended, and looks into the error queue.
    pub(super) fn end(&mut self, command: &str, patience_s: f64) -> Result<(), BusError> {
        let message = watched(command);
        self.checked(command, &message, patience_s)
    }

    /// The answer to `message`, 1 and the oldest error, as the end of a command.
    fn checked(&mut self, command: &str, message: &str, patience_s: f64) -> Result<(), BusError> {
        let answer = self.bus.line(self.side, message, patience_s)?;
        match answer.split_once(';') {
            Some((_, error)) if error.starts_with('0') => Ok(()),
            Some((_, error)) => {
                let refused =
                    |error: &str| BusError::Refused { side: self.side, message: command.into(), error: error.into() };
                let first = refused(error);
                // the rest of the queue belongs to the same failure
                let _ = self.ask("*CLS;*STB?");
                Err(first)
            }
            None => Err(self.strange(message, &answer, "1 and an error entry")),
        }
    }
}

/// Longest that a message of a setup goes on, s.
const SETUP_S: f64 = 30.0;

/// Why a message is none that sets something up: nothing in it, or a question, whose answer nobody would read.
pub fn no_setup(message: &str) -> Option<&'static str> {
    match message {
        _ if message.trim().is_empty() => Some("there is nothing in it"),
        _ if message.contains('?') => Some("it asks, and nobody would read the answer; give commands alone"),
        _ if message.contains('\n') => Some("it is more than one line; give each by itself"),
        _ => None,
    }
}

/// A command that is answered when all it has begun has ended.
fn watched(command: &str) -> String {
    format!("{command};*OPC?;:SYST:ERR?")
}
