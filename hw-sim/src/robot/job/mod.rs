//! INFORM jobs: the text of a `.JBI` file parsed, and run.
//!
//! The part of the language that a scan needs: labels, jumps, arithmetic on B, I, D and R variables, waiting, moving to P
//! variables and to the job's own positions, outputs, calls. Sub-tasks, arcs, splines and everything of a process are
//! refused when the file is loaded.

mod calculate;
pub mod instruction;
mod line;
pub mod parse;
pub mod run;
mod words;

use std::collections::BTreeMap;

use thiserror::Error;

use crate::robot::refused::Refused;
use crate::robot::variables::Position;
use instruction::Instruction;

/// A job that can be run. Line 0 is NOP, the last END.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// Name without extension.
    pub name: String,
    /// Positions of the job itself, by the number after C.
    pub positions: BTreeMap<u16, Position>,
    /// P variables that loading the job sets.
    pub variables: BTreeMap<u16, Position>,
    /// One a line; comments and labels are lines too.
    pub instructions: Vec<Instruction>,
}

impl Job {
    /// Number of the last move at or before a line: 0 before the first.
    pub fn step(&self, line: usize) -> u32 {
        let until = self.instructions.len().min(line + 1);
        let is_move = |instruction: &&Instruction| matches!(instruction, Instruction::Move { .. });
        self.instructions[..until].iter().filter(is_move).count() as u32
    }
}

/// Why a text is no job.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{refused}: {what}, line {line} of the file")]
pub struct JobError {
    /// Code for the client.
    pub refused: Refused,
    /// Line of the file, counted from 1.
    pub line: usize,
    /// What is wrong.
    pub what: &'static str,
}

/// Whether a job may be called so: 1 to 32 characters of ASCII, none that file names or INFORM use otherwise.
pub fn is_job_name(name: &str) -> bool {
    let is_right = |byte: u8| byte.is_ascii_graphic() && !b"/\\:*?\"<>|,'.()[]=".contains(&byte);
    (1..=JOB_NAME_BYTES_MAX).contains(&name.len()) && name.bytes().all(is_right)
}

/// Longest name of a job.
pub const JOB_NAME_BYTES_MAX: usize = 32;
