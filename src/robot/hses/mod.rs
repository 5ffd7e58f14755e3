//! HSES: the High-Speed Ethernet Server over UDP (`docs/protocols/hses.md`).

mod reply;
mod request;
mod wire;

pub use reply::reply;
pub use request::{request, values_max};
pub use wire::{Answer, DATA_BYTES_MAX, HEADER_BYTES, Request, Service, WireError};

#[cfg(test)]
mod tests;
