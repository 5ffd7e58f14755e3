//! Measurements of bladescan that are too slow or too specific for its tests.

fn main() {}
