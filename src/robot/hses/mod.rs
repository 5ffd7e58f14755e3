//! HSES: the High-Speed Ethernet Server over UDP (`docs/protocols/hses.md`).

mod files;
mod layout;
mod reply;
mod request;
mod wire;

pub use files::{FILE_BLOCK_BYTES, FILE_BLOCKS_MAX, FileEvent, FileSettings, Files, FilesBusy};
pub use reply::reply;
pub use request::{RequestError, request, request_name, values_max};
pub use wire::{
    Answer, Block, DATA_BYTES_MAX, FileAnswer, FileFrame, FileService, HEADER_BYTES, Request, Service, WireError,
    is_frame,
};

#[cfg(test)]
mod properties;
#[cfg(test)]
mod tests;
