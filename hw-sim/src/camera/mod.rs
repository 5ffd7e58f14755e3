//! The structured-light camera: what it sees, and how it speaks.

pub mod a3dp;
pub mod fields;
pub mod message;
pub mod settings;
