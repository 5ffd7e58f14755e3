//! The faults of a camera, and which of them have happened.

use crate::camera::a3dp::Damage;
use crate::camera::trouble::{CameraFault, Phase, Trouble};
use crate::fault::Fault;

/// Troubles by trigger; each happens once.
#[derive(Clone, Debug, Default)]
pub(crate) struct Script {
    faults: Vec<CameraFault>,
    /// Whether the fault of this index has happened.
    is_met: Vec<bool>,
}

impl Script {
    /// Those of a cell's faults that are about one trigger of the camera.
    pub(crate) fn new(faults: &[Fault]) -> Self {
        let of_camera = |fault: &Fault| match fault {
            Fault::Camera(fault) => Some(*fault),
            _ => None,
        };
        let faults: Vec<CameraFault> = faults.iter().filter_map(of_camera).collect();
        Self {
            is_met: vec![false; faults.len()],
            faults,
        }
    }

    /// The first trouble of this trigger and phase that has not happened and that is wanted; it counts as happened.
    pub(crate) fn meet(&mut self, trigger_id: u64, phase: Phase, is_wanted: fn(Trouble) -> bool) -> Option<Trouble> {
        let index = self.find(trigger_id, phase, is_wanted)?;
        self.is_met[index] = true;
        Some(self.faults[index].trouble)
    }

    /// Whether [`Script::meet`] has one.
    pub(crate) fn has(&self, trigger_id: u64, phase: Phase, is_wanted: fn(Trouble) -> bool) -> bool {
        self.find(trigger_id, phase, is_wanted).is_some()
    }

    /// Faults that have happened, in the order in which they were given.
    pub(crate) fn met(&self) -> impl Iterator<Item = CameraFault> {
        let met = self.faults.iter().zip(&self.is_met).filter(|(_, is_met)| **is_met);
        met.map(|(fault, _)| *fault)
    }

    fn find(&self, trigger_id: u64, phase: Phase, is_wanted: fn(Trouble) -> bool) -> Option<usize> {
        (0..self.faults.len()).find(|index| {
            let fault = &self.faults[*index];
            !self.is_met[*index] && fault.phase == phase && fault.is_for(trigger_id) && is_wanted(fault.trouble)
        })
    }

    /// What is wrong with the message of this phase; none for most.
    pub(crate) fn mark(&mut self, trigger_id: u64, phase: Phase) -> Mark {
        let mut mark = Mark::default();
        while let Some(trouble) = self.meet(trigger_id, phase, is_of_message) {
            match trouble {
                Trouble::CorruptPayload => mark.damage = Some(Damage::Payload),
                Trouble::CorruptHeader => mark.damage = Some(Damage::Header),
                Trouble::Oversize => mark.damage = Some(Damage::Oversize),
                Trouble::DuplicateSeq => mark.is_doubled = true,
                _ => mark.is_after_gap = true,
            }
        }
        mark
    }
}

/// What is wrong with one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Mark {
    pub(crate) damage: Option<Damage>,
    /// It comes twice, with the same count.
    pub(crate) is_doubled: bool,
    /// A count is left out before it.
    pub(crate) is_after_gap: bool,
}

/// Whether a trouble is about the bytes of one message.
fn is_of_message(trouble: Trouble) -> bool {
    matches!(
        trouble,
        Trouble::CorruptPayload | Trouble::CorruptHeader | Trouble::Oversize | Trouble::DuplicateSeq | Trouble::SkipSeq
    )
}

/// Whether a trouble happens to connections, bridge or device, in the middle of its phase.
pub(crate) fn is_incident(trouble: Trouble) -> bool {
    is_of_connection(trouble) || is_of_device(trouble) || matches!(trouble, Trouble::Pause { .. })
}

/// Whether a trouble takes connections away.
pub(crate) fn is_of_connection(trouble: Trouble) -> bool {
    matches!(
        trouble,
        Trouble::Gone | Trouble::Silent | Trouble::Restart | Trouble::Kicked
    )
}

/// Whether a trouble ends an acquisition, or refuses it, with an ERROR.
pub(crate) fn is_of_device(trouble: Trouble) -> bool {
    is_lasting(trouble)
        || matches!(
            trouble,
            Trouble::Error { .. } | Trouble::Missed | Trouble::Hot { .. } | Trouble::VendorTimeout { .. }
        )
}

/// Whether a trouble takes the device away, and with it the settings.
pub(crate) fn is_lasting(trouble: Trouble) -> bool {
    matches!(trouble, Trouble::Reset { .. } | Trouble::Lost { .. } | Trouble::Broken)
}
