//! The simulated camera: what it sees and how it speaks.
