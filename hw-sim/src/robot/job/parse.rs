//! The text of a `.JBI` file, read strictly: `/JOB`, `//NAME`, `//POS`, `//INST`, NOP first, END last, CRLF.

use std::collections::BTreeMap;

use crate::robot::job::instruction::{Index, Instruction, Operand, Operation, Place, Target};
use crate::robot::job::words::{self, Word};
use crate::robot::job::{Job, JobError, is_job_name};
use crate::robot::moves::{FORM, Path};
use crate::robot::refused::Refused;
use crate::robot::variables::{Kind, Position};

impl Job {
    /// Reads a file.
    pub fn parse(text: &[u8]) -> Result<Self, JobError> {
        let lines = lines(text)?;
        let mut reader = Reader::default();
        for (index, line) in lines.iter().enumerate() {
            let at = index + 1;
            reader.take(line, at).map_err(|(refused, what)| JobError {
                refused,
                line: at,
                what,
            })?;
        }
        reader.finish(lines.len())
    }
}

/// Part of the file that is being read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Part {
    #[default]
    Start,
    Job,
    Positions,
    Instructions,
    Body,
    Ended,
}

/// How the positions that follow are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Frame {
    #[default]
    Pulse,
    Base,
    Robot,
}

#[derive(Default)]
struct Reader {
    part: Part,
    name: Option<String>,
    /// Numbers of C, BC, EC, P, BP and EX positions.
    announced: Option<[u16; 6]>,
    tool: i32,
    frame: Frame,
    own: BTreeMap<u16, Position>,
    variables: BTreeMap<u16, Position>,
    body: Vec<(String, usize)>,
}

impl Reader {
    fn take(&mut self, line: &str, at: usize) -> Word<()> {
        match (self.part, line) {
            (Part::Start, "/JOB") => self.part = Part::Job,
            (Part::Start, _) => return Err((Refused::TEXT_FORMAT, "the file does not begin with /JOB")),
            (Part::Ended, "") => (),
            (Part::Ended, _) => return Err((Refused::TEXT_NOP_END, "something follows END")),
            (Part::Body, _) => {
                if line.trim() == "END" {
                    self.part = Part::Ended;
                }
                if self.body.len() == LINE_COUNT_MAX {
                    return Err((Refused::JOB_MEMORY, "the job is too long"));
                }
                self.body.push((line.trim().to_owned(), at));
            }
            (Part::Instructions, "NOP") => {
                self.part = Part::Body;
                self.body.push((line.to_owned(), at));
            }
            (Part::Instructions, _) if line.starts_with("///") => return self.head(line),
            (Part::Instructions, _) => return Err((Refused::TEXT_NOP_END, "the instructions do not begin with NOP")),
            (Part::Job, "//POS") => self.part = Part::Positions,
            (Part::Job | Part::Positions, "//INST") => self.part = Part::Instructions,
            (Part::Job, _) => self.take_name(line)?,
            (Part::Positions, _) => self.take_position(line)?,
        }
        Ok(())
    }

    fn take_name(&mut self, line: &str) -> Word<()> {
        let name = line
            .strip_prefix("//NAME ")
            .ok_or((SYNTAX_OUTSIDE, "//NAME, //POS or //INST is expected"))?;
        if self.name.is_some() {
            return Err((RECORD_JOB, "the job has two names"));
        }
        if !is_job_name(name) {
            return Err((Refused::JOB_NAME, "a job cannot be called so"));
        }
        self.name = Some(name.to_owned());
        Ok(())
    }

    /// Heads of the instructions: shown on a pendant, and without effect here.
    fn head(&self, line: &str) -> Word<()> {
        let name = line.split(' ').next().unwrap_or_default();
        let is_group = |name: &str| {
            name.strip_prefix("///GROUP")
                .is_some_and(|number| words::whole(number).is_ok())
        };
        match name {
            "///DATE" | "///COMM" | "///ATTR" | "///FRAME" | "///LVARS" => Ok(()),
            _ if is_group(name) => Ok(()),
            _ => Err((Refused::TEXT_PSEUDO_INSTRUCTION, "no such pseudo-instruction")),
        }
    }

    fn take_position(&mut self, line: &str) -> Word<()> {
        let (name, value) = line.split_once(' ').unwrap_or((line, ""));
        match (name, value) {
            ("///NPOS", _) => {
                let counts = numbers::<u16>(value)?;
                let counts = counts
                    .try_into()
                    .map_err(|_| (Refused::TEXT_NUMBER_COUNT, "///NPOS has six numbers"))?;
                self.announced = Some(counts);
            }
            ("///TOOL", _) => {
                self.tool = i32::from(words::whole(value)?);
                if self.tool >= 64 {
                    return Err((Refused::TEXT_RANGE, "no such tool"));
                }
            }
            ("///POSTYPE", "PULSE") => self.frame = Frame::Pulse,
            ("///POSTYPE", "BASE") => self.frame = Frame::Base,
            ("///POSTYPE", "ROBOT") => self.frame = Frame::Robot,
            ("///POSTYPE", _) => return Err((Refused::TEXT_POSITION, "positions of this type cannot be read")),
            ("///PULSE" | "///RECTAN" | "///RCONF" | "///GROUP1", _) => (),
            _ if name.starts_with("///") => {
                return Err((Refused::TEXT_PSEUDO_INSTRUCTION, "no such pseudo-instruction"));
            }
            _ => return self.take_numbers(line),
        }
        Ok(())
    }

    /// "C00000=..." or "P00010=...".
    fn take_numbers(&mut self, line: &str) -> Word<()> {
        let wrong = (Refused::TEXT_POSITION, "a position is expected");
        let (name, values) = line.split_once('=').ok_or(wrong)?;
        let (into, number) = match name.strip_prefix('C') {
            Some(number) => (&mut self.own, number),
            None => (&mut self.variables, name.strip_prefix('P').ok_or(wrong)?),
        };
        let number = words::whole(number)?;
        let values = numbers::<f64>(values)?;
        if values.len() != 6 {
            return Err((Refused::TEXT_NUMBER_COUNT, "a position has six numbers"));
        }
        let mut axes = [0; 8];
        for (index, (axis, value)) in axes.iter_mut().zip(&values).enumerate() {
            let factor = match (self.frame, index) {
                (Frame::Pulse, _) => 1.0,
                (_, 0..3) => 1000.0,
                _ => 10_000.0,
            };
            let scaled = (value * factor).round();
            if scaled.abs() > 1e9 {
                return Err((Refused::TEXT_RANGE, "a position is out of range"));
            }
            *axis = scaled as i32;
        }
        let (kind, form) = match self.frame {
            Frame::Pulse => (0, 0),
            Frame::Base => (16, FORM),
            Frame::Robot => (17, FORM),
        };
        let position = Position {
            kind,
            form,
            tool: self.tool,
            axes,
            ..Position::default()
        };
        match into.insert(number, position) {
            None => Ok(()),
            Some(_) => Err((Refused::TEXT_POSITION, "a position is there twice")),
        }
    }

    fn finish(self, line_count: usize) -> Result<Job, JobError> {
        let at_end = |(refused, what)| JobError {
            refused,
            line: line_count,
            what,
        };
        let name = self.name.ok_or_else(|| at_end((RECORD_JOB, "the job has no name")))?;
        if self.part != Part::Ended {
            return Err(at_end((Refused::TEXT_NOP_END, "there is no NOP or no END")));
        }
        if let Some([own, _, _, variables, ..]) = self.announced
            && (usize::from(own), usize::from(variables)) != (self.own.len(), self.variables.len())
        {
            let wrong = (
                Refused::TEXT_NUMBER_COUNT,
                "///NPOS announces other positions than there are",
            );
            return Err(at_end(wrong));
        }
        let mut labels = BTreeMap::new();
        for (line, (text, at)) in self.body.iter().enumerate() {
            let label = label(text).map_err(|(refused, what)| JobError {
                refused,
                line: *at,
                what,
            })?;
            if let Some(label) = label
                && labels.insert(label, line).is_some()
            {
                return Err(JobError {
                    refused: Refused::TEXT_SYNTAX,
                    line: *at,
                    what: "a label is there twice",
                });
            }
        }
        let read = |(text, at): &(String, usize)| {
            instruction(text, &labels, &self.own).map_err(|(refused, what)| JobError {
                refused,
                line: *at,
                what,
            })
        };
        Ok(Job {
            name,
            instructions: self.body.iter().map(read).collect::<Result<_, _>>()?,
            positions: self.own,
            variables: self.variables,
        })
    }
}

/// Lines of the file, each ended by CRLF.
fn lines(text: &[u8]) -> Result<Vec<&str>, JobError> {
    let mut found = Vec::new();
    let mut rest = text;
    while !rest.is_empty() {
        let wrong = |what| JobError {
            refused: Refused::TEXT_FORMAT,
            line: found.len() + 1,
            what,
        };
        let end = rest.windows(2).position(|pair| pair == b"\r\n");
        let end = end.ok_or_else(|| wrong("a line does not end in CR LF"))?;
        let line = &rest[..end];
        if line.len() > LINE_BYTES_MAX || line.iter().any(|byte| !(32..127).contains(byte) && *byte != b'\t') {
            return Err(wrong("a line is too long, or not of ASCII"));
        }
        let line = core::str::from_utf8(line).map_err(|_| wrong("a line is not of ASCII"))?;
        found.push(line);
        rest = &rest[end + 2..];
    }
    Ok(found)
}

fn numbers<T: core::str::FromStr>(values: &str) -> Word<Vec<T>> {
    let number = |value: &str| {
        value
            .trim()
            .parse()
            .map_err(|_| (Refused::TEXT_POSITION, "a number is expected"))
    };
    values.split(',').map(number).collect()
}

/// Label that a line is, or none.
fn label(text: &str) -> Word<Option<&str>> {
    let Some(label) = text.strip_prefix('*') else {
        return Ok(None);
    };
    let label = label.split_whitespace().next().unwrap_or_default();
    let is_right = !label.is_empty() && label.len() <= 8 && label.bytes().all(|byte| byte.is_ascii_graphic());
    if is_right {
        Ok(Some(label))
    } else {
        Err((Refused::LABEL_NAME, "a label cannot be called so"))
    }
}

fn instruction(text: &str, labels: &BTreeMap<&str, usize>, own: &BTreeMap<u16, Position>) -> Word<Instruction> {
    if text.is_empty() || text.starts_with(['\'', '*']) {
        return Ok(Instruction::Nothing);
    }
    let (name, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    let rest = rest.trim();
    let (main, condition) = match rest.split_once("IF ") {
        Some((main, condition)) if matches!(name, "JUMP" | "CALL" | "PAUSE") => {
            (main.trim(), Some(words::condition(condition)?))
        }
        _ => (rest, None),
    };
    match name {
        "NOP" if rest.is_empty() => Ok(Instruction::Nothing),
        "MSG" => Ok(Instruction::Nothing),
        "END" if rest.is_empty() => Ok(Instruction::End),
        "RET" if rest.is_empty() => Ok(Instruction::Return),
        "JUMP" => {
            let label = main
                .strip_prefix('*')
                .ok_or((Refused::TEXT_SYNTAX, "a label is expected"))?;
            let to = labels
                .get(label)
                .ok_or((Refused::TEXT_SYNTAX, "there is no such label"))?;
            Ok(Instruction::Jump { to: *to, condition })
        }
        "CALL" => {
            let job = main.strip_prefix("JOB:").filter(|job| is_job_name(job));
            let job = job.ok_or((Refused::TEXT_SYNTAX, "a job is expected"))?.to_owned();
            Ok(Instruction::Call { job, condition })
        }
        "PAUSE" if main.is_empty() => Ok(Instruction::Pause { condition }),
        "WAIT" => wait(rest),
        "TIMER" => {
            let time = rest
                .strip_prefix("T=")
                .ok_or((Refused::TEXT_SYNTAX, "T= is expected"))?;
            Ok(Instruction::Timer {
                time: words::time(time)?,
            })
        }
        "MOVJ" | "MOVL" => moving(name, rest, own),
        "PSTART" | "PWAIT" | "MOVC" | "MOVS" | "IMOV" | "REFP" | "SPEED" | "ABORT" => Err((
            Refused::INSTRUCTION_NOT_HERE,
            "the simulated controller has no such instruction",
        )),
        _ => calculation(name, &rest.split_whitespace().collect::<Vec<_>>()),
    }
}

fn wait(rest: &str) -> Word<Instruction> {
    let (condition, time) = match rest.split_once(" T=") {
        Some((condition, time)) => (condition, Some(words::time(time.trim())?)),
        None => (rest, None),
    };
    Ok(Instruction::Wait {
        condition: words::condition(condition)?,
        time,
    })
}

fn moving(name: &str, rest: &str, own: &BTreeMap<u16, Position>) -> Word<Instruction> {
    let mut rest = rest.split_whitespace();
    let target = rest.next().unwrap_or_default();
    let target = match (target.strip_prefix('C'), target.strip_prefix('P')) {
        (Some(number), _) => {
            let number = words::whole(number)?;
            if !own.contains_key(&number) {
                return Err((Refused::POSITION_MISSING, "the job has no such position"));
            }
            Target::Own(number)
        }
        (None, Some(index)) => Target::Variable(words::index(index)?),
        (None, None) => return words::syntax("a position is expected"),
    };
    let mut speed = None;
    for word in rest {
        match words::speed(word)? {
            Some(written) => speed = Some(written),
            None if ["PL=", "ACC=", "DEC=", "CR="].iter().any(|tag| word.starts_with(tag)) => (),
            None => return words::syntax("a move has no such tag"),
        }
    }
    let speed = speed.ok_or((Refused::TEXT_SYNTAX, "a move has no speed"))?;
    let path = if name == "MOVJ" { Path::Link } else { Path::Straight };
    if (path == Path::Link) != (speed.class == 0) {
        return words::syntax("a move has no such speed");
    }
    Ok(Instruction::Move { path, target, speed })
}

fn calculation(name: &str, words: &[&str]) -> Word<Instruction> {
    let operation = match name {
        "SET" => Operation::Set,
        "ADD" | "INC" => Operation::Add,
        "SUB" | "DEC" => Operation::Subtract,
        "MUL" => Operation::Multiply,
        "DIV" => Operation::Divide,
        "MOD" => Operation::Modulo,
        "AND" => Operation::And,
        "OR" => Operation::Or,
        "XOR" => Operation::Xor,
        "NOT" => Operation::Not,
        _ => return signal_or_position(name, words),
    };
    match (name, words) {
        ("INC" | "DEC", [to]) => Ok(Instruction::Compute {
            operation,
            to: words::place(to)?,
            by: Operand::Integer(1),
        }),
        ("INC" | "DEC", _) => words::syntax("one variable is expected"),
        ("SET", [to, from]) if to.starts_with('P') => Ok(Instruction::CopyPosition {
            to: position(to)?,
            from: position(from)?,
        }),
        (_, [to, by]) => Ok(Instruction::Compute {
            operation,
            to: bits_or_number(operation, words::place(to)?)?,
            by: words::operand(by)?,
        }),
        _ => words::syntax("two operands are expected"),
    }
}

fn signal_or_position(name: &str, words: &[&str]) -> Word<Instruction> {
    match (name, words) {
        ("DOUT", [signals, state]) => {
            let signals = words::signals(signals)?;
            if !signals.is_output {
                return words::syntax("an output is expected");
            }
            let from = words::state(state)?;
            Ok(Instruction::Out { signals, from })
        }
        ("DIN", [to, signals]) => Ok(Instruction::In {
            to: words::place(to)?,
            signals: words::signals(signals)?,
        }),
        ("CLEAR", [to, count]) => Ok(Instruction::Clear {
            to: words::place(to)?,
            count: if *count == "ALL" {
                None
            } else {
                Some(words::whole(count)?)
            },
        }),
        ("GETS", [to, from @ ("$PX000" | "$PX001")]) => Ok(Instruction::CurrentPosition {
            to: position(to)?,
            is_pulses: *from == "$PX000",
        }),
        ("SETE", [to, element, from]) => {
            let element = element.strip_prefix('(').and_then(|rest| rest.strip_suffix(')'));
            let element = words::whole(element.ok_or((Refused::TEXT_SYNTAX, "(1) to (8) is expected"))?)?;
            if !(1..=8).contains(&element) {
                return Err((Refused::TEXT_RANGE, "a position has eight elements"));
            }
            Ok(Instruction::SetElement {
                to: position(to)?,
                element,
                from: words::operand(from)?,
            })
        }
        _ => words::syntax("no such instruction, or not so many operands"),
    }
}

/// Bitwise operations are for B variables.
fn bits_or_number(operation: Operation, place: Place) -> Word<Place> {
    let is_bitwise = matches!(
        operation,
        Operation::And | Operation::Or | Operation::Xor | Operation::Not
    );
    if is_bitwise && place.kind != Kind::B {
        return words::syntax("a B variable is expected");
    }
    Ok(place)
}

fn position(word: &str) -> Word<Index> {
    words::index(
        word.strip_prefix('P')
            .ok_or((Refused::TEXT_SYNTAX, "a P variable is expected"))?,
    )
}

/// Syntax outside the instructions.
const SYNTAX_OUTSIDE: Refused = Refused(0x5310);
/// The record of the job is wrong.
const RECORD_JOB: Refused = Refused(0x5390);
const LINE_COUNT_MAX: usize = 10_000;
const LINE_BYTES_MAX: usize = 256;

#[cfg(test)]
#[path = "parse_tests.rs"]
mod tests;
