//! What clients ask for.

use super::TriggerId;
use crate::camera::payload::payload_struct;

payload_struct! {
    /// The greeting: the first message of a connection (4.1).
    #[derive(Debug, Clone, PartialEq, Eq)]
    Hello {
        /// The lowest version spoken: major, minor.
        min_version: [u8; 2];
        /// The highest version spoken: major, minor.
        max_version: [u8; 2];
        /// [`Self::CONTROLLER`] or [`Self::OBSERVER`].
        role: u8, pad 3;
        /// Names the run; 0 for an observer.
        run_id: u64;
        /// Who greets: 1 to 64 bytes.
        client_name: String;
    }
}

impl Hello {
    /// The role that may say everything.
    pub const CONTROLLER: u8 = 1;
    /// The role that only reads.
    pub const OBSERVER: u8 = 2;

    /// The greeting of a controller that speaks version 1.0.
    pub fn controller(run_id: u64, client_name: &str) -> Self {
        Self {
            min_version: [1, 0],
            max_version: [1, 0],
            role: Self::CONTROLLER,
            run_id,
            client_name: client_name.to_owned(),
        }
    }

    /// The greeting of an observer that speaks version 1.0.
    pub fn observer(client_name: &str) -> Self {
        Self {
            role: Self::OBSERVER,
            ..Self::controller(0, client_name)
        }
    }
}

payload_struct! {
    /// Makes the camera wait for triggers (4.6).
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    Arm {
        /// [`Self::SOFTWARE`]; nothing else is served.
        mode: u8, pad 3;
        /// The settings in force.
        config_id: u32;
    }
}

impl Arm {
    /// Software triggers.
    pub const SOFTWARE: u8 = 1;
}

payload_struct! {
    /// Starts one acquisition (4.7).
    #[derive(Debug, Clone, PartialEq, Eq)]
    Trigger {
        /// Its name.
        trigger_id: TriggerId;
        /// The view it is for.
        view_id: u32;
        /// The settings in force.
        config_id: u32;
        /// How long after acceptance the frame is wanted, ms; 0 = without limit.
        deadline_ms: u32;
        /// For the server's log: at most 64 bytes.
        tag: String;
    }
}
