//! Framing: the bytes of a link, one by one, into messages.
//!
//! [`Framer`] alone decides what a byte is; whoever walks over a message (lexer, watch for `!`, parser) uses it, so
//! that they cannot disagree about where a string, a block or a message ends. A fault inside a message (string
//! without end, short or oversized block) is left in the text for the parser, which names it after the units before
//! it have run; only a message that is too long is dropped whole.

use heapless::Vec;

/// Longest message without block data and without its LF.
pub const MESSAGE_MAX: usize = 512;
/// Most block data in one message.
pub const BLOCK_MAX: usize = 4096;
/// Block data that is kept of one message: the largest calibration, which is all that a block can bring, and half of
/// another. Of more, the last block is shortened: its command sees what is none of its own, and refuses it.
pub const BLOCK_KEPT: usize = 1280;
/// The byte that clears a link (CAN; block data excepted).
pub const CLEAR: u8 = 0x18;

/// What a byte is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Part of a message outside strings and blocks.
    Text,
    /// Part of a string, its quotes included.
    Quoted,
    /// `#` or a digit of a block's length.
    BlockHead,
    /// Data of a block.
    BlockData,
    /// The LF that ends a message.
    End,
    /// `!` at the start of a line: abort now.
    Abort,
    /// Rest of the line of a `!`, its LF included.
    Ignored,
    /// Clear the link.
    Clear,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    LineStart,
    /// `gap`: a `#` here begins a block.
    Text {
        gap: bool,
    },
    Quoted(u8),
    Hash,
    Length {
        digits: u8,
        value: u32,
    },
    Block {
        left: u32,
    },
    Ignore,
}

/// Classifies bytes; holds none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Framer {
    state: State,
}

impl Framer {
    /// At the start of a line.
    pub const fn new() -> Self {
        Framer { state: State::LineStart }
    }

    /// At the start of a message unit: `!` has no meaning there.
    pub const fn inside() -> Self {
        Framer { state: State::Text { gap: false } }
    }

    /// At the start of a parameter, where a block may begin.
    pub const fn parameter() -> Self {
        Framer { state: State::Text { gap: true } }
    }

    /// True while a block's length or data is awaited: the only place where a link may time out.
    pub fn in_block(&self) -> bool {
        matches!(self.state, State::Hash | State::Length { .. } | State::Block { .. })
    }

    /// True at the start of a line: no message has begun.
    pub fn is_at_start(&self) -> bool {
        self.state == State::LineStart
    }

    /// True inside a string.
    pub fn in_string(&self) -> bool {
        matches!(self.state, State::Quoted(_))
    }

    /// Takes the next byte.
    #[inline(always)]
    pub fn step(&mut self, byte: u8) -> Class {
        if self.is_plain(byte) { Class::Text } else { self.step_any(byte) }
    }

    /// Takes the next byte if it is a letter, digit, sign or point of a message, as most bytes are: what means something
    /// lies before them.
    #[inline(always)]
    pub fn is_plain(&mut self, byte: u8) -> bool {
        let State::Text { gap } = &mut self.state else { return false };
        *gap &= byte <= b',';
        byte > b','
    }

    #[inline(never)]
    fn step_any(&mut self, byte: u8) -> Class {
        let (state, class) = match self.state {
            State::Block { left } => (after_block(left - 1), Class::BlockData),
            _ if byte == CLEAR => (State::LineStart, Class::Clear),
            State::Ignore if byte == b'\n' => (State::LineStart, Class::Ignored),
            State::Ignore => (State::Ignore, Class::Ignored),
            _ if byte == b'\n' => (State::LineStart, Class::End),
            State::LineStart if byte == b'!' => (State::Ignore, Class::Abort),
            State::LineStart => text(byte, false),
            State::Text { gap } => text(byte, gap),
            State::Quoted(quote) if byte == quote => (State::Text { gap: false }, Class::Quoted),
            State::Quoted(quote) => (State::Quoted(quote), Class::Quoted),
            State::Hash => match byte {
                b'1'..=b'9' => (State::Length { digits: byte - b'0', value: 0 }, Class::BlockHead),
                _ => text(byte, false),
            },
            State::Length { digits, value } => match byte {
                b'0'..=b'9' => {
                    let value = value * 10 + u32::from(byte - b'0');
                    let next =
                        if digits == 1 { after_block(value) } else { State::Length { digits: digits - 1, value } };
                    (next, Class::BlockHead)
                }
                _ => text(byte, false),
            },
        };
        self.state = state;
        class
    }
}

impl Default for Framer {
    fn default() -> Self {
        Self::new()
    }
}

fn after_block(left: u32) -> State {
    if left == 0 { State::Text { gap: false } } else { State::Block { left } }
}

fn text(byte: u8, gap: bool) -> (State, Class) {
    match byte {
        b'"' | b'\'' => (State::Quoted(byte), Class::Quoted),
        b'#' if gap => (State::Hash, Class::BlockHead),
        b',' => (State::Text { gap: true }, Class::Text),
        _ if is_space(byte) => (State::Text { gap: true }, Class::Text),
        _ => (State::Text { gap: false }, Class::Text),
    }
}

/// White space of IEEE 488.2 (7.4.1.2): every control character but LF, and the space.
pub const fn is_space(byte: u8) -> bool {
    byte <= b' ' && byte != b'\n'
}

/// What has become of the bytes so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Nothing yet.
    None,
    /// A message stands in [`Lexer::message`]; [`Lexer::release`] before the next byte.
    Message,
    /// A message was too long and has been dropped (-363).
    TooLong,
    /// `!`.
    Abort,
    /// 0x18; the lexer is already empty.
    Clear,
}

/// Collects one message.
#[derive(Clone, Debug, Default)]
pub struct Lexer {
    framer: Framer,
    text: Vec<u8, { MESSAGE_MAX + BLOCK_KEPT }>,
    /// Block data that came, and how much of it is kept.
    block_bytes: usize,
    block_kept: usize,
    /// Where the `#` of the last block stands.
    block_at: usize,
    /// Nothing more is kept of this message (its block is too large): what is there ends in a broken block.
    cut: bool,
    too_long: bool,
    carriage_return: bool,
}

impl Lexer {
    /// At the start of a line.
    pub const fn new() -> Self {
        Lexer {
            framer: Framer::new(),
            text: Vec::new(),
            block_bytes: 0,
            block_kept: 0,
            block_at: 0,
            cut: false,
            too_long: false,
            carriage_return: false,
        }
    }

    /// Takes the next byte.
    pub fn push(&mut self, byte: u8) -> Event {
        match self.framer.step(byte) {
            Class::Clear => {
                self.release();
                Event::Clear
            }
            Class::Abort => Event::Abort,
            Class::Ignored => Event::None,
            Class::End if self.too_long => {
                self.release();
                Event::TooLong
            }
            Class::End => Event::Message,
            Class::BlockData => {
                self.block_bytes += 1;
                self.cut |= self.block_bytes > BLOCK_MAX;
                if self.block_kept < BLOCK_KEPT {
                    self.block_kept += 1;
                    self.keep(byte);
                } else if !self.in_block() {
                    self.shorten_block();
                }
                Event::None
            }
            Class::Text if byte == b'\r' => {
                self.flush_carriage_return();
                self.carriage_return = true;
                Event::None
            }
            class @ (Class::Text | Class::Quoted | Class::BlockHead) => {
                self.flush_carriage_return();
                if class == Class::BlockHead && byte == b'#' {
                    self.block_at = self.text.len();
                }
                if self.text.len().saturating_sub(self.block_kept) >= MESSAGE_MAX {
                    self.too_long = true;
                }
                self.keep(byte);
                Event::None
            }
        }
    }

    /// A carriage return before LF belongs to the end; elsewhere it is white space.
    fn flush_carriage_return(&mut self) {
        if core::mem::take(&mut self.carriage_return) {
            self.keep(b' ');
        }
    }

    #[inline(never)]
    fn keep(&mut self, byte: u8) {
        if !self.cut && !self.too_long && self.text.push(byte).is_err() {
            self.too_long = true;
        }
    }

    /// The last block has ended, and is not all there: its head says what is.
    #[inline(never)]
    fn shorten_block(&mut self) {
        let Some([b'#', digits, rest @ ..]) = self.text.get_mut(self.block_at..).filter(|_| !self.cut) else { return };
        let Some((length, data)) = rest.split_at_mut_checked(usize::from(digits.wrapping_sub(b'0'))) else { return };
        let mut left = data.len();
        for digit in length.iter_mut().rev() {
            *digit = b'0' + (left % 10) as u8;
            left /= 10;
        }
    }

    /// The message, without its end.
    pub fn message(&self) -> &[u8] {
        &self.text
    }

    /// Forgets the message.
    pub fn release(&mut self) {
        self.text.clear();
        (self.block_bytes, self.block_kept) = (0, 0);
        (self.cut, self.too_long, self.carriage_return) = (false, false, false);
    }

    /// True while a block is awaited.
    pub fn in_block(&self) -> bool {
        self.framer.in_block()
    }

    /// True when no message has begun.
    pub fn is_at_start(&self) -> bool {
        self.framer.is_at_start()
    }

    /// No byte came for two seconds: a block that is awaited is given up, its message is [`Event::Message`] with a
    /// short block (-161 from the parser). Elsewhere nothing happens: a message may be typed by hand.
    pub fn timeout(&mut self) -> Event {
        if !self.in_block() {
            return Event::None;
        }
        self.framer = Framer::new();
        if self.too_long {
            self.release();
            return Event::TooLong;
        }
        Event::Message
    }

    /// Back to an empty line.
    pub fn clear(&mut self) {
        self.framer = Framer::new();
        self.release();
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::String;
    use std::vec;
    use std::vec::Vec;

    /// Everything that comes out, in order.
    fn run(input: &[u8]) -> Vec<(Event, Vec<u8>)> {
        let mut lexer = Lexer::default();
        let mut out = vec![];
        for byte in input {
            match lexer.push(*byte) {
                Event::None => {}
                Event::Message => {
                    out.push((Event::Message, lexer.message().to_vec()));
                    lexer.release();
                }
                event => out.push((event, vec![])),
            }
        }
        out
    }

    fn message(text: &[u8]) -> (Event, Vec<u8>) {
        (Event::Message, text.to_vec())
    }

    #[test]
    fn lf_and_cr_lf_end_a_message() {
        assert_eq!(run(b"*IDN?\nA\r\n\nB\rC\r\n"), [message(b"*IDN?"), message(b"A"), message(b""), message(b"B C")]);
    }

    #[test]
    fn lf_clear_and_abort_are_data_inside_a_block() {
        assert_eq!(run(b"L #15\n!\x18\n;\n!x\n"), [message(b"L #15\n!\x18\n;"), (Event::Abort, vec![])]);
    }

    #[test]
    fn lf_ends_a_message_even_in_a_string() {
        assert_eq!(run(b"A \"x\nB\n"), [message(b"A \"x"), message(b"B")]);
        assert_eq!(run(b"A '#15;'\nB\n"), [message(b"A '#15;'"), message(b"B")]);
    }

    #[test]
    fn a_message_of_512_bytes_passes_and_of_513_is_dropped() {
        let line = |n: usize| String::from_utf8(vec![b'A'; n]).unwrap() + "\r\nOK\n";
        assert_eq!(run(line(512).as_bytes()), [message(&[b'A'; 512]), message(b"OK")]);
        assert_eq!(run(line(513).as_bytes()), [(Event::TooLong, vec![]), message(b"OK")]);
        assert_eq!(run(line(9000).as_bytes()), [(Event::TooLong, vec![]), message(b"OK")]);
    }

    #[test]
    fn of_a_block_of_4096_bytes_the_first_ones_pass_and_a_larger_one_is_cut_but_never_read_as_commands() {
        let block = |n: usize| [std::format!("L #4{n:04}").as_bytes(), &vec![b'\n'; n], b"\nOK\n"].concat();
        let full = block(BLOCK_KEPT);
        assert_eq!(run(&full), [message(&full[..BLOCK_KEPT + 8]), message(b"OK")]);
        assert_eq!(run(&block(4096)), [message(&full[..BLOCK_KEPT + 8]), message(b"OK")]);
        let events = run(&block(4097));
        assert_eq!(events.len(), 2);
        assert!(events[0].1.len() < 4097 + 8, "the parser sees a short block");
        assert_eq!(events[1], message(b"OK"));
    }

    #[test]
    fn a_block_that_is_not_kept_whole_says_so_and_what_stands_behind_it_is_read() {
        let data = |n: usize| vec![b'x'; n];
        let sent = [b"L #41000", &data(1000)[..], b";M #9000000500", &data(500), b";N #15abcde;O 1\n"].concat();
        let kept = [b"L #41000", &data(1000)[..], b";M #9000000280", &data(280), b";N #10;O 1"].concat();
        assert_eq!(run(&sent), [message(&kept)]);
    }

    #[test]
    fn a_large_block_that_is_given_up_is_a_short_one() {
        let mut lexer = Lexer::default();
        for byte in [b"L #43000", &vec![b'x'; 2999][..]].concat() {
            assert_eq!(lexer.push(byte), Event::None);
        }
        assert_eq!(lexer.timeout(), Event::Message);
        assert!(lexer.message().starts_with(b"L #43000x"));
    }

    #[test]
    fn exclamation_mark_counts_only_as_the_first_byte_of_a_line() {
        assert_eq!(run(b"A!\n!junk;*RST \"\nB\n"), [message(b"A!"), (Event::Abort, vec![]), message(b"B")]);
    }

    #[test]
    fn clear_forgets_the_line() {
        assert_eq!(
            run(b"ABC\x18DEF\n'x\x18G\n"),
            [(Event::Clear, vec![]), message(b"DEF"), (Event::Clear, vec![]), message(b"G")]
        );
    }

    #[test]
    fn a_time_out_gives_up_a_block_only() {
        let mut lexer = Lexer::default();
        for byte in b"L #210abc" {
            assert_eq!(lexer.push(*byte), Event::None);
        }
        assert_eq!(lexer.timeout(), Event::Message);
        assert_eq!(lexer.message(), b"L #210abc");
        lexer.release();
        lexer.push(b'A');
        assert_eq!(lexer.timeout(), Event::None);
        assert_eq!(lexer.push(b'\n'), Event::Message);
        assert_eq!(lexer.message(), b"A");
    }
}
