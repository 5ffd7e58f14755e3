//! The simulated cell as a program of its own.

fn main() {}
