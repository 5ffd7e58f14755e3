//! Instructions of a job, parsed.

use crate::robot::moves::Path;
use crate::robot::variables::Kind;

/// One line of a job.
#[derive(Clone, Debug, PartialEq)]
pub enum Instruction {
    /// NOP, a comment, a label, and what shows only on a pendant.
    Nothing,
    /// End of the job.
    End,
    /// Back to the calling job; the end of the first one.
    Return,
    /// Goes to a line if the condition holds.
    Jump {
        /// Line of the label.
        to: usize,
        /// Always, if none.
        condition: Option<Condition>,
    },
    /// Runs another job and comes back.
    Call {
        /// Its name.
        job: String,
        /// Always, if none.
        condition: Option<Condition>,
    },
    /// Stops the job; the next start goes on behind.
    Pause {
        /// Always, if none.
        condition: Option<Condition>,
    },
    /// Computes and stores.
    Compute {
        /// What is done with the old value and the operand.
        operation: Operation,
        /// B, I, D or R variable.
        to: Place,
        /// Second operand.
        by: Operand,
    },
    /// Sets this many variables from one on to zero.
    Clear {
        /// First of them.
        to: Place,
        /// How many; all to the last, if none.
        count: Option<u16>,
    },
    /// Copies a P variable.
    CopyPosition {
        /// Number of the P variable set.
        to: Index,
        /// Number of the P variable read.
        from: Index,
    },
    /// Sets one number of a P variable.
    SetElement {
        /// Number of the P variable.
        to: Index,
        /// 1 to 8: axis or coordinate.
        element: u16,
        /// Pulses, µm or 0.0001 degrees.
        from: Operand,
    },
    /// Stores where the arm is.
    CurrentPosition {
        /// Number of the P variable.
        to: Index,
        /// In pulses, not in the base.
        is_pulses: bool,
    },
    /// Waits for a condition.
    Wait {
        /// What is waited for.
        condition: Condition,
        /// Longest wait; then the job goes on.
        time: Option<Time>,
    },
    /// Waits.
    Timer {
        /// How long.
        time: Time,
    },
    /// Moves the arm; the job goes on once it stands.
    Move {
        /// Way to the target.
        path: Path,
        /// Where to.
        target: Target,
        /// How fast.
        speed: WrittenSpeed,
    },
    /// Sets an output.
    Out {
        /// Which.
        signals: SignalsAt,
        /// 0 or 1; 0 to 255 for a group.
        from: Operand,
    },
    /// Reads an input into a B variable.
    In {
        /// B variable.
        to: Place,
        /// Which.
        signals: SignalsAt,
    },
}

/// What [`Instruction::Compute`] does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// Stores the operand.
    Set,
    /// Sum.
    Add,
    /// Difference.
    Subtract,
    /// Product.
    Multiply,
    /// Quotient, towards zero between integers.
    Divide,
    /// Remainder.
    Modulo,
    /// Bitwise and, of B variables.
    And,
    /// Bitwise or, of B variables.
    Or,
    /// Bitwise exclusive or, of B variables.
    Xor,
    /// The operand's bits turned, of B variables.
    Not,
}

/// Number of a variable or signal, known or held by a variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Index {
    /// As written.
    Constant(u16),
    /// Held by a B, I or D variable of this number.
    Variable(Kind, u16),
}

/// A variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// B, I, D or R.
    pub kind: Kind,
    /// Its number.
    pub index: Index,
}

/// A number, known or held by a variable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Operand {
    /// Whole number as written.
    Integer(i64),
    /// Number with a point as written.
    Real(f64),
    /// Value of a variable.
    Variable(Place),
}

/// A span of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Time {
    /// In seconds.
    Seconds(f64),
    /// Held by a variable, in 0.01 s.
    Variable(Place),
}

/// Inputs or outputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalsAt {
    /// General outputs, not inputs.
    pub is_output: bool,
    /// Eight of them: the number counts groups.
    pub is_group: bool,
    /// Number from 1.
    pub number: Index,
}

/// Comparison that a condition makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Comparison {
    /// =
    Equal,
    /// <>
    Unequal,
    /// <
    Less,
    /// <=
    LessEqual,
    /// >
    Greater,
    /// >=
    GreaterEqual,
}

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Side {
    /// Number.
    Number(Operand),
    /// State of signals.
    Signals(SignalsAt),
}

/// What a jump or a wait asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Condition {
    /// Left of the sign.
    pub left: Side,
    /// The sign.
    pub comparison: Comparison,
    /// Right of the sign.
    pub right: Side,
}

/// Where a move goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Position of the job itself.
    Own(u16),
    /// P variable.
    Variable(Index),
}

/// Speed of a move: class as in [`crate::robot::moves::OrderedSpeed`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrittenSpeed {
    /// 0 share of the fastest (VJ), 1 tool point (V), 2 turn (VR).
    pub class: i32,
    /// In 0.01 %, 0.1 mm/s or 0.1 deg/s, as variables hold it.
    pub value: Operand,
}
