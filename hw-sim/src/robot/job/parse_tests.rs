use super::*;
use crate::robot::job::instruction::Instruction;

/// A job around these lines.
fn text(body: &str) -> String {
    let lines = format!(
        "/JOB\n//NAME T1\n//POS\n///NPOS 1,0,0,0,0,0\n///TOOL 1\n///POSTYPE BASE\n///RECTAN\n///RCONF 0,0,0,0,0,0\n\
         C00000=500.000,-250.000,750.000,180.0000,0.0000,-90.0000\n//INST\n///DATE 2026/01/02 03:04\n///ATTR SC,RW\n\
         ///GROUP1 RB1\nNOP\n{body}END\n"
    );
    lines.replace('\n', "\r\n")
}

fn refusal(text: &str) -> (u16, usize) {
    let error = Job::parse(text.as_bytes()).unwrap_err();
    (error.refused.0, error.line)
}

#[test]
fn a_job_has_its_name_its_positions_and_one_instruction_a_line() {
    let job = Job::parse(text("'A COMMENT IF ANY\n*TOP\nMOVJ C00000 VJ=50.00 PL=0\nJUMP *TOP IF B010<>1\n").as_bytes())
        .unwrap();
    assert_eq!((job.name.as_str(), job.instructions.len()), ("T1", 6));
    let position = job.positions[&0];
    assert_eq!((position.kind, position.tool), (16, 1));
    assert_eq!(
        position.axes,
        [500_000, -250_000, 750_000, 1_800_000, 0, -900_000, 0, 0]
    );
    assert!(matches!(
        job.instructions[4],
        Instruction::Jump {
            to: 2,
            condition: Some(_)
        }
    ));
    assert_eq!((job.step(2), job.step(3), job.step(5)), (0, 1, 1));
}

#[test]
fn every_instruction_of_a_scan_is_read() {
    for line in [
        "SET B010 1",
        "SET D021 D020",
        "SET R001 1.5",
        "SET B[D021] 3",
        "SET P[10] P[D021]",
        "ADD I001 -1",
        "SUB D001 2",
        "MUL R001 2.0",
        "DIV D001 I001",
        "MOD D001 2",
        "INC B010",
        "DEC D[B001]",
        "AND B001 15",
        "NOT B001 B002",
        "CLEAR B000 10",
        "CLEAR D000 ALL",
        "WAIT B010=1",
        "WAIT B010=1 T=5.00",
        "WAIT IN#(1)=ON T=I010",
        "WAIT D001 >= D002",
        "TIMER T=0.50",
        "MOVJ P010 VJ=I005",
        "MOVL P[D021] V=D025 PL=0",
        "MOVL C00000 VR=30.0 PL=1 ACC=50",
        "DOUT OT#(1) ON",
        "DOUT OG#(B001) 255",
        "DIN B001 IN#(16)",
        "PAUSE",
        "PAUSE IF B001=1",
        "CALL JOB:OTHER-1",
        "CALL JOB:OTHER IF IN#(3)=OFF",
        "RET",
        "GETS P005 $PX001",
        "SETE P005 (3) D001",
        "MSG \"READY IF ANY\"",
        "NOP",
        "",
    ] {
        let read = Job::parse(text(&format!("{line}\n")).as_bytes());
        assert!(read.is_ok(), "{line}: {read:?}");
    }
}

#[test]
fn a_wrong_instruction_is_refused_with_its_line() {
    for (line, code) in [
        ("JUMP *NOWHERE", 0x5110),
        ("JUMP TOP", 0x5110),
        ("SET", 0x5110),
        ("SET B010", 0x5110),
        ("SET X010 1", 0x5110),
        ("SET B010 99999999999", 0x5200),
        ("WAIT B010", 0x5110),
        ("TIMER 1", 0x5110),
        ("TIMER T=9999", 0x5200),
        ("MOVJ C00000", 0x5110),
        ("MOVJ C00000 V=10", 0x5110),
        ("MOVL C00000 V=0", 0x5200),
        ("MOVL C00001 V=10", 0x4130),
        ("MOVL C00000 V=10 NWAIT", 0x5110),
        ("MOVC C00000 V=10", 0x4230),
        ("PSTART JOB:A SUB1", 0x4230),
        ("FLY", 0x5110),
        ("AND D001 1", 0x5110),
        ("SETE P001 (9) D001", 0x5200),
        ("DOUT IN#(1) ON", 0x5110),
        ("*", 0x4200),
        ("CALL JOB:", 0x5110),
    ] {
        assert_eq!(refusal(&text(&format!("{line}\n"))), (code, 15), "{line}");
    }
}

#[test]
fn a_wrong_frame_of_a_job_has_the_code_of_the_sheet() {
    let good = text("");
    assert!(Job::parse(good.as_bytes()).is_ok());
    for (from, to, code, line) in [
        ("/JOB\r\n", "", 0x5170, 1),
        ("\r\nEND", "\nEND", 0x5170, 14),
        ("NOP\r\n", "", 0x5130, 14),
        ("END\r\n", "", 0x5130, 14),
        ("END\r\n", "END\r\nNOP\r\n", 0x5130, 16),
        ("//NAME T1\r\n", "", 0x5390, 14),
        ("//NAME T1", "//NAME T 1", 0x4190, 2),
        ("//NAME T1\r\n", "//NAME T1\r\nNOP\r\n", 0x5310, 3),
        ("///NPOS 1,", "///NPOS 2,", 0x5180, 15),
        ("///NPOS 1,", "///NPOS ", 0x5180, 4),
        ("-250.000,", "", 0x5180, 9),
        ("-250.000", "A", 0x5120, 9),
        ("POSTYPE BASE", "POSTYPE USER", 0x5120, 6),
        ("///RECTAN", "///ROUND", 0x5340, 7),
        ("///ATTR", "///ARRT", 0x5340, 12),
    ] {
        let bad = good.replacen(from, to, 1);
        assert_ne!(bad, good);
        assert_eq!(refusal(&bad), (code, line), "{from:?} to {to:?}");
    }
    assert_eq!(refusal("").0, 0x5390);
}

#[test]
fn a_job_of_pulses_has_pulses_and_sets_p_variables() {
    let body = "/JOB\n//NAME A\n//POS\n///NPOS 0,0,0,1,0,0\n///TOOL 2\n///POSTYPE PULSE\n///PULSE\nP00010=1,-2,3,4,5,6\n//INST\nNOP\nEND\n";
    let job = Job::parse(body.replace('\n', "\r\n").as_bytes()).unwrap();
    assert_eq!(job.variables[&10].axes, [1, -2, 3, 4, 5, 6, 0, 0]);
    assert_eq!((job.variables[&10].kind, job.variables[&10].tool), (0, 2));
}
