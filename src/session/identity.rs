//! Are the devices those that recipe and station mean? Only then is anything switched on.

use super::{EXPOSURE_MAX_US, EXPOSURE_MIN_US, Hold, Session};
use crate::camera::Opened;
use crate::event::Event;
use crate::fault::{Fault, FaultCode};
use crate::robot::SystemInformation;
use crate::stamp::Stamp;

impl Session {
    pub(super) fn handle_identity(&mut self, now: Stamp, system: &SystemInformation) {
        let simulated = system.simulated();
        self.emit(Event::RobotIdentified {
            model: system.model.clone(),
            software: system.software.clone(),
            simulated,
        });
        if simulated != self.wanted.simulated {
            let seen = format!("{} at an address meant for {}", system.model, self.expected("robot"));
            return self.fault(now, Fault::new(FaultCode::RobotIdentity, seen));
        }
        self.robot_known = true;
        self.switch_on(now);
    }

    pub(super) fn handle_camera_ready(&mut self, now: Stamp, opened: &Opened) {
        let (greeting, caps) = (&opened.greeting, &opened.caps);
        self.emit(Event::CameraReady {
            model: greeting.model.clone(),
            serial: greeting.serial.clone(),
            simulated: greeting.simulated,
            optics: caps.optics.clone(),
            calibration_id: greeting.calibration_id,
        });
        if greeting.simulated != self.wanted.simulated {
            let seen = format!("{} at an address meant for {}", greeting.model, self.expected("camera"));
            return self.fault(now, Fault::new(FaultCode::CameraIdentity, seen));
        }
        let [near, _, far] = caps.working_distance_mm.map(f64::from);
        let stand_off_mm = self.wanted.stand_off_mm;
        if caps.optics != self.wanted.optics {
            let seen = format!(
                "the recipe asks for optics \"{}\", the camera has \"{}\"",
                self.wanted.optics, caps.optics
            );
            return self.fault(now, Fault::new(FaultCode::CameraOptics, seen));
        }
        if !(near..=far).contains(&stand_off_mm) {
            let seen = format!("a stand-off of {stand_off_mm} mm, but the camera works from {near} to {far} mm");
            return self.fault(now, Fault::new(FaultCode::CameraOptics, seen));
        }
        self.exposure_range_us = [
            caps.exposure_min_us.max(EXPOSURE_MIN_US),
            caps.exposure_max_us.min(EXPOSURE_MAX_US),
        ];
        self.camera_known = true;
        self.switch_on(now);
    }

    /// Both devices are who they should be: only now is anything switched on.
    fn switch_on(&mut self, now: Stamp) {
        if self.robot_known && self.camera_known && self.ending.is_none() && self.hold == Hold::No {
            self.arm.make_ready(now);
        }
    }

    fn expected(&self, device: &str) -> String {
        let kind = if self.wanted.simulated { "simulated" } else { "real" };
        format!("a {kind} {device}")
    }
}
