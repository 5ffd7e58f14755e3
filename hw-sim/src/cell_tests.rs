use super::*;
use crate::blade::Builtin;
use crate::camera::message::Message;
use crate::robot::pose::{Pose, isometry_from_mm_deg};
use crate::test_client::{Client, arm, configure, hello, small_settings, trigger};
use crate::truth::{PoseErrorSize, motion_from_rows};
use crate::vectors::{HSES_PAGE, vector};

const SECOND_NS: u64 = 1_000_000_000;

/// A scene in which the blade stands in the middle of the view.
fn scene() -> Scene {
    let scene = Scene::default();
    let camera_from_blade = isometry_from_mm_deg([0.0, 10.0, 280.0], [90.0, 0.0, 0.0]);
    let base_from_tool = scene.base_from_camera * camera_from_blade * scene.tool_from_blade.inverse();
    Scene {
        home: Pose::from_isometry(&base_from_tool),
        ..scene
    }
}

/// The cell, rendering inline on virtual time.
struct Bench {
    cell: Cell,
    renderer: Renderer,
    client: Client,
    now_ns: u64,
    /// Bytes of all chunks since the last look.
    chunks: Vec<u8>,
    kinds: Vec<u16>,
    answers: Vec<Vec<u8>>,
    render_count: usize,
}

impl Bench {
    fn new(scene: Scene) -> Self {
        let renderer = Renderer::new(&Builtin::HptA.mesh(), scene.surface).unwrap();
        let mut bench = Self {
            cell: Cell::new(scene),
            renderer,
            client: Client::default(),
            now_ns: 0,
            chunks: Vec::new(),
            kinds: Vec::new(),
            answers: Vec::new(),
            render_count: 0,
        };
        bench.put(Input::CameraConnected { connection: 1 });
        for message in [hello(), configure(&small_settings()), arm(1)] {
            bench.ask(&message);
        }
        bench
    }

    fn put(&mut self, input: Input) {
        self.cell.handle_input(self.now_ns, input);
        while let Some(output) = self.cell.poll_output() {
            match output {
                Output::RobotDatagram { bytes, .. } => self.answers.push(bytes),
                Output::CameraBytes { bytes, .. } => {
                    for (_, message) in self.client.read(&bytes) {
                        self.kinds.push(message.kind());
                        if let Message::FrameChunk(chunk) = message {
                            self.chunks.extend_from_slice(&chunk.data.0);
                        }
                    }
                }
                Output::Render(job) => {
                    self.render_count += 1;
                    let frame = job.run(&self.renderer);
                    self.cell
                        .handle_input(self.now_ns, Input::Rendered { job: job.job, frame });
                }
                Output::CameraClose { .. } | Output::RobotPort(_) | Output::Violation(_) => panic!("{output:?}"),
                Output::TruthGrew => (),
            }
        }
    }

    fn ask(&mut self, message: &Message) {
        let bytes = self.client.request(message);
        self.put(Input::CameraBytes { connection: 1, bytes });
    }

    fn robot(&mut self, name: &str) {
        let bytes = vector(HSES_PAGE, name);
        self.put(Input::RobotDatagram {
            from: "127.0.0.1:4711".parse().unwrap(),
            bytes,
        });
    }

    fn pass(&mut self, until_ns: u64) {
        while let Some(wake_ns) = self.cell.wake_at().filter(|wake_ns| *wake_ns <= until_ns) {
            self.now_ns = wake_ns;
            self.put(Input::Wake);
        }
        self.now_ns = until_ns;
    }

    /// Bytes of the frame of one trigger.
    fn take(&mut self, trigger_id: u64) -> Vec<u8> {
        self.ask(&trigger(trigger_id, 0));
        self.pass(self.now_ns + SECOND_NS);
        assert!(self.kinds.contains(&0x32));
        self.kinds.clear();
        std::mem::take(&mut self.chunks)
    }
}

#[test]
fn without_errors_the_blade_is_where_station_and_robot_say() {
    let mut bench = Bench::new(Scene {
        pose_error: PoseErrorSize::default(),
        ..scene()
    });
    bench.take(3 << 16);
    let view = &bench.cell.truth().views[0];
    let camera_from_blade = motion_from_rows(&view.camera_from_blade).unwrap();
    let expected = isometry_from_mm_deg([0.0, 10.0, 280.0], [90.0, 0.0, 0.0]);
    let between = expected.inverse() * camera_from_blade;
    assert!(
        between.translation.vector.norm() < 2e-3 && between.rotation.angle() < 3e-6,
        "{between}"
    );
    assert_eq!(
        (view.view_index, view.attempt, view.moved_during_exposure),
        (3, 0, false)
    );
    assert!(!view.surface_points_mm.is_empty());
}

#[test]
fn the_same_seed_gives_the_same_bytes_whatever_came_before() {
    let mut alone = Bench::new(scene());
    let frame = alone.take(3 << 16);
    let mut later = Bench::new(scene());
    let first = later.take(2 << 16);
    assert_ne!(first, frame);
    assert_eq!(later.take(3 << 16), frame);
    assert_ne!(later.take(3 << 16 | 1), frame, "a retake draws anew");
    assert_ne!(Bench::new(Scene { seed: 2, ..scene() }).take(3 << 16), frame);
}

#[test]
fn the_pose_error_is_in_the_truth_and_never_in_what_the_robot_says() {
    let mut bench = Bench::new(scene());
    bench.robot("req_position");
    bench.take(0);
    bench.take(1);
    bench.robot("req_position");
    assert_eq!(bench.answers[0], bench.answers[1]);
    let truth = bench.cell.truth();
    assert_ne!(truth.views[0].camera_from_blade, truth.views[1].camera_from_blade);
}

#[test]
fn a_move_during_the_exposure_is_told_in_the_truth() {
    let mut bench = Bench::new(scene());
    bench.robot("req_servo_on");
    bench.robot("req_move_base_50mm_s");
    bench.take(0);
    let views = &bench.cell.truth().views;
    assert!(views[0].moved_during_exposure);
    let mut still = Bench::new(scene());
    still.robot("req_servo_on");
    still.ask(&trigger(0, 0));
    still.pass(SECOND_NS / 2);
    still.robot("req_move_base_50mm_s");
    still.pass(SECOND_NS);
    assert!(
        !still.cell.truth().views[0].moved_during_exposure,
        "after EXPOSURE_DONE the part may move"
    );
}

#[test]
fn a_second_copy_of_the_move_that_led_here_is_no_move() {
    let mut bench = Bench::new(Scene {
        speed: 1000.0,
        ..scene()
    });
    bench.robot("req_servo_on");
    bench.robot("req_move_base_50mm_s");
    bench.pass(SECOND_NS);
    bench.ask(&trigger(0, 0));
    bench.robot("req_move_base_50mm_s");
    bench.pass(2 * SECOND_NS);
    assert_eq!(bench.cell.robot().accepted_move_count(), 2);
    assert!(!bench.cell.truth().views[0].moved_during_exposure);
}

#[test]
fn a_repeated_trigger_is_rendered_once_and_an_aborted_exposure_has_no_truth() {
    let mut bench = Bench::new(scene());
    bench.ask(&trigger(0, 0));
    bench.ask(&trigger(0, 0));
    bench.ask(&Message::Abort(0));
    bench.pass(SECOND_NS);
    assert_eq!((bench.render_count, bench.cell.truth().views.len()), (1, 0));
    bench.take(1);
    assert_eq!((bench.render_count, bench.cell.truth().views.len()), (2, 1));
}

#[test]
fn the_truth_lists_the_faults() {
    let faults = vec!["late-frame=0.5@9".parse().unwrap(), "elsewhere=2@1".parse().unwrap()];
    let cell = Cell::new(Scene { faults, ..scene() });
    assert_eq!(cell.truth().faults, ["late-frame=0.5@9", "elsewhere=2@1"]);
}
