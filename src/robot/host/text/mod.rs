//! Commands and answers of host control as text, the same on both links (`docs/protocols/host_control.md`, section 3).

mod answer;
mod number;
mod phrase;

pub use answer::{expects_data, form, refusal_code, reply, result_code, system_information};
pub use phrase::{Phrase, phrase};

#[cfg(test)]
mod tests;
