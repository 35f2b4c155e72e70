//! From the bytes of a client to lines: commands of the gateway, and data for an instrument.
//!
//! A line ends with a CR or LF that is not escaped. ESC (27) in front of CR, LF, ESC or `+` takes their meaning away;
//! a line that begins with `++` is a command. Lines without a byte are nothing, so CR LF ends one line.

/// Takes the meaning of the next byte away.
const ESCAPE: u8 = 27;
/// Most bytes of a line that are kept; a longer one goes on in parts.
const MOST: usize = 8192;
/// Most bytes of a command; the rest is cut off.
const COMMAND_MOST: usize = 256;

/// A line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Line {
    /// Behind its `++`, without white space at the ends.
    Command(String),
    /// Data, unescaped; `whole`: the line ends here.
    Data { bytes: Vec<u8>, whole: bool },
}

/// Collects a line.
#[derive(Clone, Debug, Default)]
pub(super) struct Lines {
    bytes: Vec<u8>,
    escaped: bool,
    /// So many of the first two bytes are `+` without an escape.
    pluses: usize,
    /// A part of this line has been handed out.
    going_on: bool,
}

impl Lines {
    /// Takes the next byte; a line when it is whole, or too long to be kept.
    pub fn push(&mut self, byte: u8) -> Option<Line> {
        if std::mem::take(&mut self.escaped) {
            self.bytes.push(byte);
        } else {
            match byte {
                ESCAPE => {
                    self.escaped = true;
                    return None;
                }
                b'\r' | b'\n' => return self.end(),
                b'+' if !self.going_on && self.bytes.len() == self.pluses && self.pluses < 2 => {
                    self.pluses += 1;
                    self.bytes.push(byte);
                }
                _ => self.bytes.push(byte),
            }
        }
        if self.is_command() {
            self.bytes.truncate(COMMAND_MOST);
            return None;
        }
        (self.bytes.len() >= MOST).then(|| {
            (self.going_on, self.pluses) = (true, 0);
            Line::Data { bytes: std::mem::take(&mut self.bytes), whole: false }
        })
    }

    /// No byte of a line has come.
    pub fn is_at_start(&self) -> bool {
        self.bytes.is_empty() && !self.going_on
    }

    /// What has come of the line is `!`.
    pub fn is_abort(&self) -> bool {
        self.bytes == b"!" && !self.going_on
    }

    fn is_command(&self) -> bool {
        self.pluses == 2
    }

    fn end(&mut self) -> Option<Line> {
        let command = self.is_command();
        let Lines { bytes, going_on, .. } = std::mem::take(self);
        if command {
            let text = String::from_utf8_lossy(&bytes[2..]);
            return Some(Line::Command(text.trim().to_owned()));
        }
        (going_on || !bytes.is_empty()).then_some(Line::Data { bytes, whole: true })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(input: &[u8]) -> Vec<Line> {
        let mut lines = Lines::default();
        input.iter().filter_map(|byte| lines.push(*byte)).collect()
    }

    fn data(bytes: &[u8]) -> Line {
        Line::Data { bytes: bytes.to_vec(), whole: true }
    }

    fn command(text: &str) -> Line {
        Line::Command(text.to_owned())
    }

    #[test]
    fn lines_end_with_cr_lf_or_both_and_empty_ones_are_nothing() {
        assert_eq!(run(b"*IDN?\r\n\n++addr 5\r*CLS\n"), [data(b"*IDN?"), command("addr 5"), data(b"*CLS")]);
    }

    #[test]
    fn an_escape_takes_the_meaning_of_the_next_byte() {
        assert_eq!(run(b"a\x1b\nb\x1b\rc\x1b\x1bd\x1b+\n"), [data(b"a\nb\rc\x1bd+")]);
        assert_eq!(run(b"\x1b++ver\n+\x1b+ver\n+ver\n"), [data(b"++ver"), data(b"++ver"), data(b"+ver")]);
        assert_eq!(run(b"++ver\n1++ver\n"), [command("ver"), data(b"1++ver")]);
    }

    #[test]
    fn every_byte_can_be_sent() {
        let all: Vec<u8> = (0..=255).collect();
        let escape = |byte: &u8| if b"\r\n\x1b+".contains(byte) { vec![ESCAPE, *byte] } else { vec![*byte] };
        let mut sent: Vec<u8> = all.iter().flat_map(escape).collect();
        sent.push(b'\n');
        assert_eq!(run(&sent), [data(&all)]);
    }

    #[test]
    fn a_line_without_end_comes_in_parts() {
        let lines = run(&[&[b'a'; MOST + 5][..], b"++x\n\n"].concat());
        assert_eq!(lines[0], Line::Data { bytes: vec![b'a'; MOST], whole: false });
        assert_eq!(lines[1..], [data(b"aaaaa++x")]);
    }
}
