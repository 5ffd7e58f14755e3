//! Recipe and station files: TOML text becomes meaning, or an error that points at the place.
//!
//! Reading goes in two steps. The text is checked against a table of keys ([`RECIPE_KEYS`], [`STATION_KEYS`]: type, unit,
//! default, range) and becomes *what was written*, one plain structure per table of the file. [`Recipe`] and [`Station`]
//! are *what it means*: millimetres, radians, nanoseconds, every relation between keys settled. Past them nothing is
//! checked again.

mod error;
mod keys;
mod recipe;
mod retakes;
mod source;
mod station;
mod written;

pub use error::SettingsError;
pub use keys::{Key, Kind, Need, RECIPE_KEYS, Range, STATION_KEYS};
pub use recipe::{
    Cad, CameraSettings, Check, Compression, Exposure, Merge, Optics, OutlierFilter, Recipe, Registration, Roi, Start,
    Views, WarmUp, WorkingVolume,
};
pub use retakes::{RetakeReason, Retakes};
pub use station::{
    CameraLink, HostPort, Motion, RobotAddress, RobotLink, RobotProtocol, ScanJob, Station, Target, Workspace,
};
