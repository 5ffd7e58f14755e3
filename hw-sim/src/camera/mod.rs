//! The structured-light camera: its optics, the frames it takes of a mesh, and how it speaks A3DP/1.

pub mod a3dp;
mod acquisition;
mod artefacts;
mod bridge;
mod capture;
mod connection;
pub mod device;
pub mod fields;
mod frame;
mod grid;
mod identity;
pub mod message;
mod noise;
pub mod optics;
pub mod payload;
mod radiometry;
pub mod render;
mod requests;
mod script;
pub mod settings;
mod site;
mod store;
pub mod surface;
mod thermal;
pub mod transfer;
pub mod trouble;
