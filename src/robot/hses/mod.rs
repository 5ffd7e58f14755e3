//! HSES: the High-Speed Ethernet Server over UDP (`docs/protocols/hses.md`).

mod layout;
mod reply;
mod request;
mod wire;

pub use reply::reply;
pub use request::{RequestError, request, values_max};
pub use wire::{
    Answer, Block, DATA_BYTES_MAX, FileAnswer, FileFrame, FileService, HEADER_BYTES, Request, Service, WireError,
};

#[cfg(test)]
mod tests;
