//! Variables as host control writes them.
//!
//! The sheet states the numbers of the kinds and no more of positions. Ours: what RPOSC and RPOSJ say, after a first number
//! that tells which: `0,S,L,U,R,B,T,7th,8th,tool` for pulses and `1,coordinate,X,Y,Z,TX,TY,TZ,type,tool,7th,8th`; and
//! `0,axis 1..8` in pulses or `1,axis 1..8` in mm for base and station axes.

use crate::robot::host::arguments::{decimal, integer, integers, list, written};
use crate::robot::host::{bytes, text};
use crate::robot::moves::COORDINATE_BASE;
use crate::robot::refused::{Answer, Refused};
use crate::robot::variables::{AxesPosition, Kind, Position, Value};

/// Kind by its number in SAVEV and LOADV.
pub(super) fn kind(number: &str) -> Answer<Kind> {
    let number: usize = integer(number)?;
    Kind::ALL.get(number).copied().ok_or(Refused::OPERAND_RANGE)
}

/// The value as text.
pub(super) fn value_text(value: &Value) -> String {
    match value {
        Value::B(value) => value.to_string(),
        Value::I(value) => value.to_string(),
        Value::D(value) => value.to_string(),
        Value::R(value) => value.to_string(),
        Value::S(value) => {
            let end = value.iter().position(|byte| *byte == 0).unwrap_or(value.len());
            text(&value[..end])
        }
        Value::P(position) => position_text(position),
        Value::Bp(axes) | Value::Ex(axes) => axes_text(axes),
    }
}

/// The value of a kind from its texts; 1011, 1012 or 1013 for what is none.
pub(super) fn value(kind: Kind, texts: &[&str]) -> Answer<Value> {
    let one = || match texts {
        [one] => Ok(*one),
        _ => Err(Refused::OPERAND_COUNT),
    };
    Ok(match kind {
        Kind::B => Value::B(integer(one()?)?),
        Kind::I => Value::I(integer(one()?)?),
        Kind::D => Value::D(integer(one()?)?),
        Kind::R => Value::R(integer(one()?)?),
        Kind::S => {
            let text = bytes(&texts.join(","));
            if text.len() > STRING_BYTES_MAX {
                return Err(Refused::OPERAND_LENGTH);
            }
            Value::text(&text)
        }
        Kind::P => Value::P(position(texts)?),
        Kind::Bp => Value::Bp(axes(texts)?),
        Kind::Ex => Value::Ex(axes(texts)?),
    })
}

/// Form bits as text protocols write them: no-flip, lower, back, then R, T, S as in HSES.
///
/// The sheet's trap: HSES begins with back, lower, no-flip.
pub(super) fn host_form(form: i32) -> i32 {
    let (back, no_flip) = (form & 1, form >> 2 & 1);
    form & 0b11_1010 | no_flip | back << 2
}

/// Form bits of HSES from those of a text; the swap of two bits undoes itself.
pub(super) fn form_of_host(form: i32) -> i32 {
    host_form(form)
}

/// Coordinate by the number of a text: 0 base, 1 robot, 2 and on the user coordinates from 1.
pub(super) fn coordinate(number: &str) -> Answer<Coordinate> {
    match integer::<i32>(number)? {
        number @ 0..=1 => Ok(Coordinate {
            code: COORDINATE_BASE + number,
            user: 0,
        }),
        number @ 2..=USER_MAX => Ok(Coordinate {
            code: COORDINATE_BASE + 2,
            user: number - 1,
        }),
        _ => Err(Refused::OPERAND_RANGE),
    }
}

/// A coordinate as HSES writes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Coordinate {
    pub(super) code: i32,
    pub(super) user: i32,
}

/// x, y, z in µm and Rx, Ry, Rz in 0.0001 degrees as text.
pub(super) fn pose_text(axes: [i32; 6]) -> String {
    let [x, y, z, rx, ry, rz] = axes;
    list(
        [x, y, z]
            .map(|um| written(um, 3))
            .into_iter()
            .chain([rx, ry, rz].map(|turn| written(turn, 4))),
    )
}

/// The pose of six texts.
pub(super) fn pose(texts: [&str; 6]) -> Answer<([i32; 3], [i32; 3])> {
    let [x, y, z, rx, ry, rz] = texts;
    Ok((
        [decimal(x, 3)?, decimal(y, 3)?, decimal(z, 3)?],
        [decimal(rx, 4)?, decimal(ry, 4)?, decimal(rz, 4)?],
    ))
}

fn position_text(position: &Position) -> String {
    let [a, b, c, d, e, f, seventh, eighth] = position.axes;
    if position.kind == 0 {
        return format!("0,{},{}", list(position.axes), position.tool);
    }
    let coordinate = match position.kind - COORDINATE_BASE {
        2 => position.user + 1,
        other => other,
    };
    let others = match (seventh, eighth) {
        (0, 0) => String::new(),
        _ => format!(",{seventh},{eighth}"),
    };
    format!(
        "1,{coordinate},{},{},{}{others}",
        pose_text([a, b, c, d, e, f]),
        host_form(position.form),
        position.tool
    )
}

fn position(texts: &[&str]) -> Answer<Position> {
    match texts {
        ["0", pulses @ .., tool] if (6..8).contains(&pulses.len()) => Ok(Position {
            kind: 0,
            axes: integers(&[pulses, &["0", "0"][..8 - pulses.len()]].concat())?,
            tool: integer(tool)?,
            ..Position::default()
        }),
        ["0", pulses @ .., tool] => Ok(Position {
            kind: 0,
            axes: integers(pulses)?,
            tool: integer(tool)?,
            ..Position::default()
        }),
        // No source tells whether the seventh and eighth axis belong here: they may be left out.
        ["1", number, x, y, z, rx, ry, rz, form, tool, others @ ..] => {
            let [seventh, eighth] = match others {
                [] => [0, 0],
                [seventh, eighth] => [integer(seventh)?, integer(eighth)?],
                _ => return Err(Refused::OPERAND_COUNT),
            };
            let coordinate = coordinate(number)?;
            let ([x, y, z], [rx, ry, rz]) = pose([x, y, z, rx, ry, rz])?;
            Ok(Position {
                kind: coordinate.code,
                user: coordinate.user,
                form: form_of_host(integer(form)?),
                tool: integer(tool)?,
                form_ext: 0,
                axes: [x, y, z, rx, ry, rz, seventh, eighth],
            })
        }
        ["0" | "1", ..] | [] => Err(Refused::OPERAND_COUNT),
        _ => Err(Refused::OPERAND_RANGE),
    }
}

fn axes_text(axes: &AxesPosition) -> String {
    if axes.kind == 0 {
        format!("0,{}", list(axes.axes))
    } else {
        format!("1,{}", list(axes.axes.map(|um| written(um, 3))))
    }
}

fn axes(texts: &[&str]) -> Answer<AxesPosition> {
    match texts {
        ["0", pulses @ ..] => Ok(AxesPosition {
            kind: 0,
            axes: integers(pulses)?,
        }),
        ["1", mm @ ..] => {
            let axes: Vec<i32> = mm.iter().map(|mm| decimal(mm, 3)).collect::<Answer<_>>()?;
            Ok(AxesPosition {
                kind: COORDINATE_BASE,
                axes: axes.try_into().map_err(|_| Refused::OPERAND_COUNT)?,
            })
        }
        [] => Err(Refused::OPERAND_COUNT),
        _ => Err(Refused::OPERAND_RANGE),
    }
}

/// Of an S variable.
const STRING_BYTES_MAX: usize = 32;
/// Largest coordinate number; the sheet knows no bound, 63 user coordinates are that of other commands.
const USER_MAX: i32 = 64;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_form_bits_swap_back_and_no_flip_and_keep_the_others() {
        for (hses, host) in [
            (0b000_100, 1),
            (0b000_001, 4),
            (0b000_010, 2),
            (0b111_101, 0b111_101),
            (0b011_000, 0b011_000),
        ] {
            assert_eq!(host_form(hses), host, "{hses:#b}");
            assert_eq!(form_of_host(host), hses, "{host:#b}");
        }
    }

    #[test]
    fn every_kind_is_read_back_as_it_was_written() {
        let cartesian = Position {
            kind: 17,
            form: 4,
            tool: 1,
            user: 0,
            form_ext: 0,
            axes: [500_000, -250_005, 1, 1_800_000, -1, -900_000, 7, 8],
        };
        for value_in in [
            Value::B(255),
            Value::I(-32_768),
            Value::D(i32::MIN),
            Value::R(-0.1),
            Value::text(b"A, B"),
            Value::P(cartesian),
            Value::P(Position {
                kind: 18,
                user: 3,
                ..cartesian
            }),
            Value::P(Position {
                kind: 0,
                form: 0,
                ..cartesian
            }),
            Value::Bp(AxesPosition {
                kind: 16,
                axes: [-1, 2, 3, 4, 5, 6, 7, 8],
            }),
            Value::Ex(AxesPosition {
                kind: 0,
                axes: [-1, 2, 3, 4, 5, 6, 7, 8],
            }),
        ] {
            let written = value_text(&value_in);
            let texts: Vec<&str> = written.split(',').collect();
            assert_eq!(value(value_in.kind(), &texts), Ok(value_in), "{written}");
        }
        assert_eq!(
            value_text(&Value::P(cartesian)),
            "1,1,500.000,-250.005,0.001,180.0000,-0.0001,-90.0000,1,1,7,8"
        );
    }

    #[test]
    fn a_value_of_another_size_or_form_is_refused() {
        for (kind, texts, refused) in [
            (Kind::B, &["256"][..], Refused::OPERAND_RANGE),
            (Kind::B, &["1", "2"], Refused::OPERAND_COUNT),
            (Kind::R, &["x"], Refused::OPERAND_RANGE),
            (Kind::P, &["0", "1"], Refused::OPERAND_COUNT),
            (Kind::P, &["2", "1"], Refused::OPERAND_RANGE),
            (Kind::P, &[], Refused::OPERAND_COUNT),
            (Kind::Ex, &["1", "0.5"], Refused::OPERAND_COUNT),
            (Kind::S, &["123456789012345678901234567890123"], Refused::OPERAND_LENGTH),
        ] {
            assert_eq!(value(kind, texts), Err(refused), "{texts:?}");
        }
    }
}
