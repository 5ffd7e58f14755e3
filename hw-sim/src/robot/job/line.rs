//! One line of a job, read.

use std::collections::BTreeMap;

use crate::robot::job::instruction::{Index, Instruction, Operand, Operation, Place, Target};
use crate::robot::job::is_job_name;
use crate::robot::job::words::{self, Word};
use crate::robot::moves::Path;
use crate::robot::refused::Refused;
use crate::robot::variables::{Kind, Position};

/// Instruction on a line; `labels` are the lines of the labels, `own` the positions of the job.
pub(super) fn instruction(
    text: &str,
    labels: &BTreeMap<&str, usize>,
    own: &BTreeMap<u16, Position>,
) -> Word<Instruction> {
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
