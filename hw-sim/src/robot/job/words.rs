//! The words of an instruction: variables, numbers, signals, conditions.

use crate::robot::job::instruction::{
    Comparison, Condition, Index, Operand, Place, Side, SignalsAt, Time, WrittenSpeed,
};
use crate::robot::refused::Refused;
use crate::robot::variables::Kind;

/// A word understood, or why not.
pub(super) type Word<T> = Result<T, (Refused, &'static str)>;

/// "B010", "B[10]", "B[I005]"; B, I, D or R.
pub(super) fn place(word: &str) -> Word<Place> {
    let kind = match word.as_bytes().first() {
        Some(b'B') => Kind::B,
        Some(b'I') => Kind::I,
        Some(b'D') => Kind::D,
        Some(b'R') => Kind::R,
        _ => return syntax("a variable B, I, D or R is expected"),
    };
    Ok(Place {
        kind,
        index: index(&word[1..])?,
    })
}

/// What stands behind the letter of a variable: "010", "[10]" or "[D021]".
pub(super) fn index(word: &str) -> Word<Index> {
    match word.strip_prefix('[') {
        Some(rest) => inner_index(rest.strip_suffix(']').ok_or(SYNTAX_INDEX)?),
        None => Ok(Index::Constant(whole(word)?)),
    }
}

/// What stands in brackets: a number or a B, I or D variable.
fn inner_index(word: &str) -> Word<Index> {
    if word.bytes().all(|byte| byte.is_ascii_digit()) {
        return Ok(Index::Constant(whole(word)?));
    }
    match place(word)? {
        Place {
            kind: kind @ (Kind::B | Kind::I | Kind::D),
            index: Index::Constant(number),
        } => Ok(Index::Variable(kind, number)),
        _ => Err(SYNTAX_INDEX),
    }
}

/// Number of digits alone.
pub(super) fn whole(word: &str) -> Word<u16> {
    if word.is_empty() || !word.bytes().all(|byte| byte.is_ascii_digit()) {
        return Err(SYNTAX_INDEX);
    }
    word.parse().map_err(|_| (Refused::TEXT_RANGE, "a number is too large"))
}

/// Variable or number.
pub(super) fn operand(word: &str) -> Word<Operand> {
    match word.as_bytes().first() {
        Some(b'0'..=b'9' | b'-' | b'+' | b'.') => number(word),
        _ => Ok(Operand::Variable(place(word)?)),
    }
}

fn number(word: &str) -> Word<Operand> {
    let is_number = word
        .bytes()
        .all(|byte| matches!(byte, b'0'..=b'9' | b'-' | b'+' | b'.'));
    let wrong = (Refused::TEXT_SYNTAX, "a number is expected");
    if !is_number {
        return Err(wrong);
    }
    if word.contains('.') {
        return word.parse().map(Operand::Real).map_err(|_| wrong);
    }
    let value: i64 = word.parse().map_err(|_| wrong)?;
    if i32::try_from(value).is_err() {
        return Err((Refused::TEXT_RANGE, "a number is too large"));
    }
    Ok(Operand::Integer(value))
}

/// "5.00" in seconds, or a variable that holds it in 0.01 s.
pub(super) fn time(word: &str) -> Word<Time> {
    match operand(word)? {
        Operand::Integer(seconds) if (0..=TIME_MAX_S).contains(&seconds) => Ok(Time::Seconds(seconds as f64)),
        Operand::Real(seconds) if (0.0..=TIME_MAX_S as f64).contains(&seconds) => Ok(Time::Seconds(seconds)),
        Operand::Variable(place) => Ok(Time::Variable(place)),
        _ => Err((Refused::TEXT_RANGE, "the time is out of range")),
    }
}

/// "VJ=50.00", "V=250.0", "VR=30.0"; variables hold it in 0.01 %, 0.1 mm/s and 0.1 deg/s.
pub(super) fn speed(word: &str) -> Word<Option<WrittenSpeed>> {
    let Some((name, value)) = word.split_once('=') else {
        return Ok(None);
    };
    let (class, factor) = match name {
        "VJ" => (0, 100.0),
        "V" => (1, 10.0),
        "VR" => (2, 10.0),
        _ => return Ok(None),
    };
    let written = match operand(value)? {
        Operand::Integer(value) => value as f64,
        Operand::Real(value) => value,
        variable @ Operand::Variable(_) => return Ok(Some(WrittenSpeed { class, value: variable })),
    };
    let value = (written * factor).round();
    if !(1.0..=100_000.0).contains(&value) {
        return Err((Refused::TEXT_RANGE, "the speed is out of range"));
    }
    Ok(Some(WrittenSpeed {
        class,
        value: Operand::Integer(value as i64),
    }))
}

/// "IN#(1)", "OT#(B001)", "IG#(2)", "OG#(2)".
pub(super) fn signals(word: &str) -> Word<SignalsAt> {
    let (name, rest) = word.split_once("#(").ok_or(SYNTAX_SIGNAL)?;
    let (is_output, is_group) = match name {
        "IN" => (false, false),
        "OT" => (true, false),
        "IG" => (false, true),
        "OG" => (true, true),
        _ => return Err(SYNTAX_SIGNAL),
    };
    Ok(SignalsAt {
        is_output,
        is_group,
        number: inner_index(rest.strip_suffix(')').ok_or(SYNTAX_SIGNAL)?)?,
    })
}

/// "B010=1", "IN#(1)=ON", "D001<>D002".
pub(super) fn condition(words: &str) -> Word<Condition> {
    let text: String = words.split_whitespace().collect();
    let signs = [
        ("<>", Comparison::Unequal),
        ("<=", Comparison::LessEqual),
        (">=", Comparison::GreaterEqual),
        ("<", Comparison::Less),
        (">", Comparison::Greater),
        ("=", Comparison::Equal),
    ];
    for (sign, comparison) in signs {
        if let Some((left, right)) = text.split_once(sign) {
            return Ok(Condition {
                left: side(left)?,
                comparison,
                right: side(right)?,
            });
        }
    }
    syntax("a condition has no sign")
}

fn side(word: &str) -> Word<Side> {
    match word {
        "ON" => Ok(Side::Number(Operand::Integer(1))),
        "OFF" => Ok(Side::Number(Operand::Integer(0))),
        _ if word.contains('#') => signals(word).map(Side::Signals),
        _ => operand(word).map(Side::Number),
    }
}

/// Value of an output: "ON", "OFF", a number or a variable.
pub(super) fn state(word: &str) -> Word<Operand> {
    match side(word)? {
        Side::Number(operand) => Ok(operand),
        Side::Signals(_) => Err(SYNTAX_SIGNAL),
    }
}

pub(super) fn syntax<T>(what: &'static str) -> Word<T> {
    Err((Refused::TEXT_SYNTAX, what))
}

const SYNTAX_INDEX: (Refused, &str) = (Refused::TEXT_SYNTAX, "the number of a variable is expected");
const SYNTAX_SIGNAL: (Refused, &str) = (Refused::TEXT_SYNTAX, "a signal is expected");
const TIME_MAX_S: i64 = 655;
