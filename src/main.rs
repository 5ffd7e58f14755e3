//! The `bladescan` program.

fn main() {}
