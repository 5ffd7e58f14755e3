//! Host control: commands in text, over TCP port 80 and over a serial line, carried out by one interpreter.

mod arguments;
pub mod bsc;
pub mod interpreter;
pub mod serial;
pub mod tcp;
mod variable;

/// A command of the host, as a link has received it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Call {
    /// Name of the command as it was sent.
    pub name: String,
    /// Its arguments, without the trailing end of line; each byte one character.
    pub data: String,
    /// When it came, ns.
    pub since_ns: u64,
}

/// What a command comes to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Carried out; the command has nothing to tell.
    Done,
    /// Carried out; values with commas between them.
    Data(String),
    /// Refused with the code of the interpreter, whose four hexadecimal digits are sent.
    Refused(u16),
    /// Not over yet: the same call is to be made again at this time, ns.
    Later(u64),
}

/// Carries commands out at a time, ns: the controller behind the links.
pub type Interpret<'a> = dyn FnMut(u64, &Call) -> Answer + 'a;

/// Each byte as one character: the protocol is ASCII, and what is not passes unharmed.
fn text(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| char::from(*byte)).collect()
}

/// What [`text`] was made of; a character that no byte gives is a question mark.
fn bytes(text: &str) -> Vec<u8> {
    text.chars().map(|c| u8::try_from(c).unwrap_or(b'?')).collect()
}
