//! What the client has to say to golden commands of host control, on either link.

use bladescan::robot::{
    Command, Cycle, JobName, Move, MovePulses, Path, Speed, Values, Variable, VariableKind, WirePose,
};

/// The command that `name` with `data` is; otherwise why the client does not say it.
pub(super) fn command(name: &str, data: &str) -> Result<Command, &'static str> {
    let fields: Vec<&str> = data.split(',').map(str::trim).collect();
    let double = |index: u16| Variable {
        kind: VariableKind::Double,
        index,
    };
    Ok(match (name, fields.as_slice()) {
        ("RSTATS", [""]) => Command::Status,
        ("RPOSC", ["0", "0"]) => Command::Position,
        ("RPOSJ", [""]) => Command::Pulses,
        ("RALARM", [""]) => Command::Alarm(0),
        ("RJSEQ", [""]) => Command::ExecutingJob,
        ("RJDIR", ["*"]) => Command::JobNames,
        ("SVON", ["1"]) => Command::ServoOn,
        ("HOLD", ["1"]) => Command::HoldOn,
        ("HOLD", ["0"]) => Command::HoldOff,
        ("RESET", [""]) => Command::AlarmReset,
        ("CANCEL", [""]) => Command::ErrorCancel,
        ("CYCLE", ["2"]) => Command::SetCycle(Cycle::Once),
        ("MDSP", [text]) => Command::ShowText((*text).to_owned()),
        ("JSEQ", [job, "0"]) => Command::SelectJob {
            job: JobName::parse(job).map_err(|_| "no name of a job")?,
            line: 0,
        },
        ("SAVEV", ["2", "42"]) => Command::Read {
            first: double(42),
            count: 1,
        },
        ("LOADV", ["2", "42", "7"]) => Command::Write {
            first: double(42),
            values: Values::Double(vec![7]),
        },
        ("IOREAD", ["10010", "8"]) => Command::ReadSignals {
            first_group: 1001,
            count: 1,
        },
        ("IOWRITE", ["27010", "8", "1"]) => Command::WriteSignals {
            first_group: 2701,
            groups: vec![1],
        },
        ("MOVL", ["0", "50.0", ..]) => straight([500_000, -250_000, 750_000], [1_800_000, 0, -900_000], 500),
        ("MOVL", ["0", "100", ..]) => straight([353_769, 202_779, 120_658], [-13_400, 357_800, 278_400], 1000),
        ("PMOVJ", ["10.00", ..]) => Command::MovePulses(MovePulses {
            pulses: [0; 8],
            path: Path::Link,
            speed: Speed::Link(1000),
            tool: 0,
        }),
        ("START", _) => return Err("START with a job begins that job anew; we start the selected one and name none"),
        ("JWAIT", _) => return Err("JWAIT blocks the line; we ask for the status"),
        ("CGROUP", _) => return Err("CGROUP: one robot, nothing to choose"),
        _ => return Err("unknown here"),
    })
}

fn straight(position_um: [i32; 3], rotation_e4_deg: [i32; 3], speed_e1_mm_s: u32) -> Command {
    Command::Move(Move {
        base_from_tool: WirePose {
            position_um,
            rotation_e4_deg,
        },
        path: Path::Straight,
        speed: Speed::ToolPoint(speed_e1_mm_s),
        tool: 0,
    })
}

/// How two texts with commas agree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Likeness {
    /// Byte for byte.
    Equal,
    /// Field by field, but for spaces around commas and decimals that are 0.
    SameFields,
    /// Not.
    Other,
}

/// How `ours` agrees with `golden`.
pub(super) fn likeness(ours: &str, golden: &str) -> Likeness {
    let numbers_agree = |ours: &str, golden: &str| matches!((ours.parse::<f64>(), golden.parse::<f64>()), (Ok(ours), Ok(golden)) if ours == golden);
    let (our_fields, golden_fields): (Vec<&str>, Vec<&str>) = (ours.split(',').collect(), golden.split(',').collect());
    let mut pairs = our_fields.iter().zip(&golden_fields);
    if ours == golden {
        Likeness::Equal
    } else if our_fields.len() == golden_fields.len()
        && pairs.all(|(ours, golden)| ours.trim() == golden.trim() || numbers_agree(ours.trim(), golden.trim()))
    {
        Likeness::SameFields
    } else {
        Likeness::Other
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_alike_but_for_spaces_and_decimals_that_are_0() {
        for (ours, golden, expected) in [
            ("0,0", "0,0", Likeness::Equal),
            ("0,0", "0, 0", Likeness::SameFields),
            ("0,100.0,-1.3400", "0,100,-1.34", Likeness::SameFields),
            ("0,100.0,-1.3401", "0,100,-1.34", Likeness::Other),
            ("0,0", "0,0,0", Likeness::Other),
            ("SCAN1,0", "SCAN2,0", Likeness::Other),
        ] {
            assert_eq!(likeness(ours, golden), expected, "{ours} | {golden}");
        }
    }
}
