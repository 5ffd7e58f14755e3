//! What is judged of a run: every frame that becomes data is the one that the simulator rendered for its trigger, whole, once.

use std::collections::{BTreeMap, BTreeSet};

use bladescan::camera::{Capture, CapturedPoints};
use bladescan::job::sha256;
use hw_sim::camera::render::Frame;

/// Frames rendered, and frames taken as data.
#[derive(Debug, Default)]
pub(crate) struct Judge {
    /// Hashes of what was rendered, by trigger id. A trigger can be rendered again after the bridge has forgotten it.
    rendered: BTreeMap<u64, BTreeSet<String>>,
    accepted_views: BTreeSet<usize>,
    accepted_count: u64,
    /// Frames whose bytes are not those rendered for their trigger.
    pub(crate) wrong: Vec<String>,
    /// Frames with fewer bytes than were rendered.
    pub(crate) partial: Vec<String>,
    /// Views that got a second frame.
    pub(crate) duplicate: Vec<String>,
}

impl Judge {
    /// The simulator rendered a frame.
    pub(crate) fn handle_rendered(&mut self, trigger_id: u64, frame: &Frame) {
        let xyz: Vec<u8> = frame
            .xyz_mm
            .iter()
            .flatten()
            .flat_map(|value_mm| value_mm.to_le_bytes())
            .collect();
        let hash = fingerprint(&xyz, &frame.intensity, &frame.mask);
        self.rendered.entry(trigger_id).or_default().insert(hash);
    }

    /// The run takes a frame as data of a view.
    pub(crate) fn handle_accepted(&mut self, view_index: usize, capture: &Capture) {
        let trigger_id = capture.trigger_id.0;
        let about = format!("view {view_index}, trigger {trigger_id:#x}");
        self.accepted_count += 1;
        if !self.accepted_views.insert(view_index) {
            self.duplicate.push(about.clone());
        }
        let pixel_count = capture.width_px as usize * capture.height_px as usize;
        let xyz: &[u8] = match &capture.points {
            CapturedPoints::Xyz(bytes) => bytes,
            CapturedPoints::Range { .. } => &[],
        };
        let intensity = capture.intensity.as_deref().unwrap_or_default();
        if [xyz.len() / 12, intensity.len(), capture.mask.len()] != [pixel_count; 3] {
            self.partial.push(about.clone());
        }
        let hash = fingerprint(xyz, intensity, &capture.mask);
        let is_of_view = trigger_id >> 16 == view_index as u64;
        let is_known = self
            .rendered
            .get(&trigger_id)
            .is_some_and(|hashes| hashes.contains(&hash));
        if !is_of_view || !is_known {
            self.wrong.push(about);
        }
    }

    /// Frames taken as data.
    pub(crate) fn accepted_count(&self) -> u64 {
        self.accepted_count
    }

    /// Everything that must not be.
    pub(crate) fn faults(&self) -> Vec<String> {
        let named = |name: &'static str, list: &[String]| -> Vec<String> {
            list.iter().map(|about| format!("{name} frame: {about}")).collect()
        };
        [
            named("wrong", &self.wrong),
            named("partial", &self.partial),
            named("duplicate", &self.duplicate),
        ]
        .concat()
    }
}

/// SHA-256 of the components one after the other.
fn fingerprint(xyz: &[u8], intensity: &[u8], mask: &[u8]) -> String {
    sha256(&[xyz, intensity, mask].concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bladescan::camera::TriggerId;

    fn frame(mark: u8) -> Frame {
        Frame {
            width_px: 2,
            height_px: 1,
            xyz_mm: vec![[1.0, 2.0, 3.0]; 2],
            mask: vec![0; 2],
            intensity: vec![mark; 2],
            confidence: vec![200; 2],
            valid_count: 2,
            saturated_count: 0,
            surface_points_mm: Vec::new(),
        }
    }

    fn capture(trigger_id: u64, mark: u8) -> Capture {
        let xyz = [1.0_f32, 2.0, 3.0].map(f32::to_le_bytes).as_flattened().repeat(2);
        Capture {
            trigger_id: TriggerId(trigger_id),
            width_px: 2,
            height_px: 1,
            valid_count: 2,
            saturated_count: 0,
            points: CapturedPoints::Xyz(xyz),
            intensity: Some(vec![mark; 2]),
            confidence: None,
            mask: vec![0; 2],
        }
    }

    #[test]
    fn the_frame_that_was_rendered_for_the_trigger_is_right() {
        let mut judge = Judge::default();
        judge.handle_rendered(1 << 16, &frame(1));
        judge.handle_accepted(1, &capture(1 << 16, 1));
        assert!(judge.faults().is_empty());
    }

    #[test]
    fn another_frame_a_part_of_it_and_a_second_one_are_not() {
        let mut judge = Judge::default();
        judge.handle_rendered(1 << 16, &frame(1));
        judge.handle_rendered(2 << 16, &frame(2));
        judge.handle_accepted(1, &capture(1 << 16, 2));
        judge.handle_accepted(2, &capture(1 << 16, 1));
        assert_eq!(judge.wrong.len(), 2, "of another trigger, of another view");
        let mut cut = capture(2 << 16, 2);
        cut.mask.pop();
        judge.handle_accepted(3, &cut);
        assert_eq!((judge.partial.len(), judge.duplicate.len()), (1, 0));
        judge.handle_accepted(2, &capture(2 << 16, 2));
        assert_eq!(judge.duplicate.len(), 1);
    }
}
