//! The command tree as JSON, for whoever writes a driver.

use stage_controller::scpi::tree::{Entry, Form, Kind, Param, TABLE};
use std::fmt::{self, Display};
use std::io::Write;

/// Prints it.
pub fn main() -> std::process::ExitCode {
    let commands = Array(TABLE.iter().map(Command));
    let (name, version) = (Text(env!("CARGO_PKG_NAME")), Text(env!("CARGO_PKG_VERSION")));
    // a reader that closes the pipe early has seen what it wanted
    match writeln!(std::io::stdout(), "{{\"name\":{name},\"version\":{version},\"commands\":{commands}}}") {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(_) => std::process::ExitCode::FAILURE,
    }
}

/// A string in quotes.
struct Text<'a>(&'a str);

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"")?;
        for c in self.0.chars() {
            match c {
                '"' | '\\' => write!(f, "\\{c}")?,
                c if c < ' ' => write!(f, "\\u{:04x}", c as u32)?,
                c => write!(f, "{c}")?,
            }
        }
        f.write_str("\"")
    }
}

/// Items between brackets.
struct Array<I>(I);

impl<I: Iterator<Item: Display> + Clone> Display for Array<I> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("[")?;
        for (n, item) in self.0.clone().enumerate() {
            write!(f, "{}{item}", if n == 0 { "" } else { "," })?;
        }
        f.write_str("]")
    }
}

#[derive(Clone)]
struct Command(&'static Entry);

impl Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Command(entry) = self;
        let parameters = |params: &'static [Param]| Array(params.iter().map(Parameter));
        let forms: &[&str] = match entry.form {
            Form::Set => &["set"],
            Form::Query => &["query"],
            Form::Both => &["set", "query"],
        };
        let errors = entry.errors.iter().map(|e| Number { code: e.code(), text: e.description() });
        write!(f, "\n{{\"header\":{},", Text(entry.pattern))?;
        write!(f, "\"forms\":{},", Array(forms.iter().map(|form| Text(form))))?;
        write!(f, "\"parameters\":{},", parameters(entry.params))?;
        write!(f, "\"query_parameters\":{},", parameters(entry.query_params))?;
        write!(f, "\"range\":{},\"default\":{},", Text(entry.range), Text(entry.default))?;
        write!(f, "\"errors\":{},", Array(errors))?;
        write!(f, "\"help\":{},\"example\":{}}}", Text(entry.help), Text(entry.example))
    }
}

#[derive(Clone)]
struct Parameter(&'static Param);

impl Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Param { name, kind, optional, extremes } = self.0;
        write!(f, "{{\"name\":{},\"kind\":{},\"unit\":{}", Text(name), Text(kind.name()), Text(kind.unit()))?;
        match kind {
            Kind::Choice(words) => write!(f, ",\"words\":{}", Array(words.iter().map(|word| Text(word))))?,
            Kind::Integer(least, most) => write!(f, ",\"minimum\":{least},\"maximum\":{most}")?,
            _ => {}
        }
        write!(f, ",\"values\":{},\"optional\":{optional},\"takes_min_max_def\":{extremes}}}", self.0.width())
    }
}

struct Number {
    code: i16,
    text: &'static str,
}

impl Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{{\"number\":{},\"text\":{}}}", self.code, Text(self.text))
    }
}
