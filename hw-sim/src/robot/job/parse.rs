//! The text of a `.JBI` file, read strictly: `/JOB`, `//NAME`, `//POS`, `//INST`, NOP first, END last, CRLF.

use std::collections::BTreeMap;

use crate::robot::job::line::instruction;
use crate::robot::job::words::{self, Word};
use crate::robot::job::{Job, JobError, is_job_name};
use crate::robot::moves::FORM;
use crate::robot::refused::Refused;
use crate::robot::variables::Position;

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

/// Syntax outside the instructions.
const SYNTAX_OUTSIDE: Refused = Refused(0x5310);
/// The record of the job is wrong.
const RECORD_JOB: Refused = Refused(0x5390);
const LINE_COUNT_MAX: usize = 10_000;
const LINE_BYTES_MAX: usize = 256;

#[cfg(test)]
#[path = "parse_tests.rs"]
mod tests;
