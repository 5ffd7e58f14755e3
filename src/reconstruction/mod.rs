//! Multiview reconstruction: each view is registered to the growing model and merged if it overlaps enough.

mod model;
mod view;

pub use self::model::{Model, ModelPoint};
pub use self::view::{Decision, DiscardReason, OverlapMin, PriorLimits, ViewRegistration, ViewSettings, register_view};
