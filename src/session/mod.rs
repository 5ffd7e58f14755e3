//! Acquisition.

mod arm;

pub use arm::{Arm, ArmEvent, ArmSettings};
