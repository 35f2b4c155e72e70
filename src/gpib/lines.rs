//! The sixteen lines of the bus.

use core::ops::{BitOr, BitOrAssign};

/// A set of bus lines that are true.
///
/// True is the low level on the wire (IEEE 488.1, 3.2): who reads pins inverts them.
#[derive(Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct Lines(u16);

impl Lines {
    /// No line is true.
    pub const NONE: Lines = Lines(0);
    /// Data lines DIO1 (bit 0) to DIO8 (bit 7).
    pub const DIO: Lines = Lines(0x00FF);
    /// End of a message, or identify together with ATN.
    pub const EOI: Lines = Lines(1 << 8);
    /// Data valid: the source has a byte on DIO.
    pub const DAV: Lines = Lines(1 << 9);
    /// Not ready for data: false only when every acceptor is ready.
    pub const NRFD: Lines = Lines(1 << 10);
    /// Not data accepted: false only when every acceptor has the byte.
    pub const NDAC: Lines = Lines(1 << 11);
    /// Interface clear.
    pub const IFC: Lines = Lines(1 << 12);
    /// Service request.
    pub const SRQ: Lines = Lines(1 << 13);
    /// Attention: what is on DIO is an interface message.
    pub const ATN: Lines = Lines(1 << 14);
    /// Remote enable.
    pub const REN: Lines = Lines(1 << 15);

    /// Lines from bits, in the order of the constants.
    pub const fn from_bits(bits: u16) -> Lines {
        Lines(bits)
    }

    /// Bits in the order of the constants.
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// The data lines that carry `byte`, DIO1 its lowest bit.
    pub const fn of_byte(byte: u8) -> Lines {
        Lines(byte as u16)
    }

    /// What the data lines carry.
    pub const fn byte(self) -> u8 {
        (self.0 & Lines::DIO.0) as u8
    }

    /// Whether any of `lines` is true.
    pub const fn has(self, lines: Lines) -> bool {
        self.0 & lines.0 != 0
    }

    /// These lines, those of `mask` alone.
    pub const fn only(self, mask: Lines) -> Lines {
        Lines(self.0 & mask.0)
    }

    /// `self` if `condition`, else no line.
    pub const fn when(self, condition: bool) -> Lines {
        if condition { self } else { Lines::NONE }
    }
}

impl BitOr for Lines {
    type Output = Lines;

    fn bitor(self, other: Lines) -> Lines {
        Lines(self.0 | other.0)
    }
}

impl BitOrAssign for Lines {
    fn bitor_assign(&mut self, other: Lines) {
        self.0 |= other.0;
    }
}

/// The names of the lines that are true, as on the connector.
impl core::fmt::Debug for Lines {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        const NAMES: [&str; 8] = ["EOI", "DAV", "NRFD", "NDAC", "IFC", "SRQ", "ATN", "REN"];
        write!(f, "{:02X}", self.byte())?;
        let mut bit = Lines::EOI.0;
        for name in NAMES {
            if self.0 & bit != 0 {
                write!(f, " {name}")?;
            }
            bit = bit.wrapping_shl(1);
        }
        Ok(())
    }
}
