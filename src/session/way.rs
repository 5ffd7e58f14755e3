//! The arm's way from view to view: straight where the station allows so wide a turn, else along the views between.

use crate::geometry::rotation_angle_between;
use crate::plan::PlannedView;
use nalgebra::UnitQuaternion;

/// Where the arm stands among the views, and where it is sent.
#[derive(Debug)]
pub(super) struct Way {
    /// The orientation of each view; of those that are skipped none.
    rotations: Vec<Option<UnitQuaternion<f64>>>,
    step_max_rad: f64,
    /// The view where the arm stood last.
    place: Option<usize>,
    heading: Option<usize>,
}

impl Way {
    pub(super) fn new(plan: &[PlannedView], step_max_rad: f64) -> Self {
        let rotation = |view: &PlannedView| (!view.skipped).then_some(view.base_from_tool.rotation);
        Self {
            rotations: plan.iter().map(rotation).collect(),
            step_max_rad,
            place: None,
            heading: None,
        }
    }

    /// Nothing is known of where the arm stands.
    pub(super) fn restart(&mut self) {
        (self.place, self.heading) = (None, None);
    }

    /// The view that the arm is sent to next on its way to `target`. The plan has checked every step between neighbours.
    pub(super) fn leave_for(&mut self, target: usize) -> usize {
        let stop = match self.place {
            Some(place) if place != target && self.is_too_wide(place, target) => self.neighbour(place, target),
            _ => target,
        };
        self.heading = Some(stop);
        stop
    }

    /// The arm stands where it was sent; returns where that is.
    pub(super) fn arrive(&mut self) -> Option<usize> {
        self.place = self.heading;
        self.place
    }

    fn is_too_wide(&self, from: usize, to: usize) -> bool {
        match (self.rotations[from], self.rotations[to]) {
            (Some(from), Some(to)) => rotation_angle_between(&from, &to) > self.step_max_rad + ROUNDING_RAD,
            _ => false,
        }
    }

    /// The next view that is taken, in the direction of `target`.
    fn neighbour(&self, place: usize, target: usize) -> usize {
        let is_taken = |view: &usize| self.rotations[*view].is_some();
        let found = if place < target {
            (place + 1..=target).find(is_taken)
        } else {
            (target..place).rev().find(is_taken)
        };
        found.unwrap_or(target)
    }
}

/// A step that is exactly the largest allowed may be wider by the rounding of its poses.
const ROUNDING_RAD: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Plan;
    use crate::seed::Seed;
    use crate::settings::{Recipe, Station};

    /// The stops between views of a plan with steps of 30°, view 2 left out.
    fn stops(step_max_deg: f64, views: &[usize]) -> Vec<usize> {
        let text = "name = \"probe\"\nblade.cad = \"builtin:lpt\"\nmerge.overlap_min_fraction = 0.5\n\
                    presentation = { position_mm = [10, -5, 600], rotation_deg = [0, 90, 0] }\n\
                    [views]\nstep_deg = 30\nskip = [2]\n";
        let plan = Plan::new(
            &Recipe::parse("probe.toml", text).unwrap(),
            &Station::builtin_simulated(),
            Seed(1),
        )
        .unwrap();
        let mut way = Way::new(plan.views(), step_max_deg.to_radians());
        let mut stops = Vec::new();
        for &view in views {
            loop {
                stops.push(way.leave_for(view));
                if way.arrive() == Some(view) {
                    break;
                }
            }
        }
        stops
    }

    #[test]
    fn a_turn_that_is_too_wide_goes_back_along_the_views_between() {
        assert_eq!(stops(180.0, &[0, 5, 1]), [0, 5, 1]);
        assert_eq!(stops(60.0, &[4, 1]), [4, 3, 1]);
        assert_eq!(stops(60.0, &[1, 5, 5]), [1, 3, 5, 5]);
        // The way around the other side is the shorter one here, and narrow enough.
        assert_eq!(stops(60.0, &[11, 0]), [11, 0]);
    }
}
