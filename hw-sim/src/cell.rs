//! The simulated cell as a value: robot, camera and the blade between them, without sockets and without a clock.

use core::net::SocketAddr;
use std::collections::{BTreeMap, VecDeque};

use nalgebra::Isometry3;

use crate::camera::device::{Device, DeviceOutput, DeviceSettings};
use crate::camera::optics::Optics;
use crate::camera::render::{Capture, Draws, Frame, Renderer};
use crate::camera::trouble::CameraFault;
use crate::pose_error::{calibration_error, pose_error};
use crate::robot::controller::{Controller, Panel, Settings};
use crate::robot::hses::Port;
use crate::robot::ports::{Passed, PortInput, PortOutput, Ports};
use crate::scene::Scene;
use crate::truth::Truth;

/// What happens to the cell.
#[derive(Clone, Debug)]
pub enum Input {
    /// A datagram for the robot controller.
    RobotDatagram {
        /// Sender; its answer goes there.
        from: SocketAddr,
        /// Whole datagram.
        bytes: Vec<u8>,
    },
    /// A client connected to the camera.
    CameraConnected {
        /// New for each connection.
        connection: u64,
    },
    /// Where a client of the camera speaks from; who is refused in its favour reads it.
    CameraAddress {
        /// Connection it speaks on.
        connection: u64,
        /// Its end of the connection.
        address: SocketAddr,
    },
    /// Bytes for the camera.
    CameraBytes {
        /// Connection they came on.
        connection: u64,
        /// Whatever piece of the stream came.
        bytes: Vec<u8>,
    },
    /// A client's connection to the camera ended.
    CameraClosed {
        /// Connection that ended.
        connection: u64,
    },
    /// A render job is done.
    Rendered {
        /// Job of [`RenderJob`].
        job: u64,
        /// What the camera sees.
        frame: Frame,
    },
    /// Something happens at a port of the robot controller.
    RobotPort(PortInput),
    /// A person does something at the robot's panel.
    Panel(Panel),
    /// Time has passed.
    Wake,
}

/// What the cell wants done.
#[derive(Clone, Debug)]
pub enum Output {
    /// An answer of the robot controller.
    RobotDatagram {
        /// Receiver.
        to: SocketAddr,
        /// Whole datagram.
        bytes: Vec<u8>,
    },
    /// What goes out at another port of the robot controller.
    RobotPort(PortOutput),
    /// Bytes of the camera.
    CameraBytes {
        /// Connection to send on.
        connection: u64,
        /// Whole frames.
        bytes: Vec<u8>,
    },
    /// End of a connection to the camera, once its bytes are sent.
    CameraClose {
        /// Connection to close.
        connection: u64,
    },
    /// A frame must be computed and come back as [`Input::Rendered`].
    Render(RenderJob),
    /// The [`Cell::truth`] has grown by one acquisition.
    TruthGrew,
    /// Someone broke a protocol; for the log.
    Violation(String),
}

/// What one acquisition sees. Equal jobs give equal frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderJob {
    /// Count of the acquisition.
    pub job: u64,
    /// Lens set.
    pub optics: Optics,
    /// True pose of the blade.
    pub camera_from_blade: Isometry3<f64>,
    /// Settings of the camera.
    pub capture: Capture,
    /// What the draws come from.
    pub draws: Draws,
}

impl RenderJob {
    /// The frame.
    pub fn run(&self, renderer: &Renderer) -> Frame {
        renderer.render(&self.optics, &self.camera_from_blade, &self.capture, &self.draws)
    }
}

/// The simulated cell.
#[derive(Clone, Debug)]
pub struct Cell {
    scene: Scene,
    robot: Ports,
    camera: Device,
    exposures: BTreeMap<u64, Exposure>,
    truth: Truth,
    outputs: VecDeque<Output>,
}

/// An acquisition whose truth is not recorded yet.
#[derive(Clone, Debug)]
struct Exposure {
    trigger_id: u64,
    camera_from_blade: Isometry3<f64>,
    was_moving: bool,
    departure_count: u32,
    /// Whether the robot moved, known once the exposure has ended.
    moved: Option<bool>,
    surface_points_mm: Option<Vec<[f64; 3]>>,
}

impl Cell {
    /// Cell at rest: the robot stands at home, nobody is connected.
    pub fn new(scene: Scene) -> Self {
        let settings = Settings {
            home: scene.home,
            workspace_min_um: scene.workspace_um[0],
            workspace_max_um: scene.workspace_um[1],
            speed: scene.speed,
            seed: scene.seed,
            faults: scene.faults.clone(),
            jobs: scene.jobs.clone(),
            options: scene.robot_options.clone(),
        };
        let robot = Ports::new(settings, scene.links);
        let camera = Device::new(DeviceSettings {
            optics: scene.optics,
            speed: scene.speed,
            boot_id: scene.boot_id,
            faults: scene.faults.clone(),
        });
        let mut truth = Truth::new(
            &scene.blade,
            scene.seed,
            scene.optics.name,
            scene.surface,
            scene.pose_error,
        );
        truth.faults = scene.faults.iter().map(ToString::to_string).collect();
        Self {
            scene,
            robot,
            camera,
            exposures: BTreeMap::new(),
            truth,
            outputs: VecDeque::new(),
        }
    }

    /// Cell of a run that was interrupted: what `earlier` tells of it stays in the truth.
    pub fn resumed(scene: Scene, mut earlier: Truth) -> Self {
        let mut cell = Self::new(scene);
        earlier.faults.append(&mut cell.truth.faults);
        (cell.truth.faults, cell.truth.views) = (earlier.faults, earlier.views);
        cell
    }

    /// Takes what happened at this time; times never go back. What was due before it happens first.
    pub fn handle_input(&mut self, now_ns: u64, input: Input) {
        self.camera.handle_wake(now_ns);
        self.drain_camera(now_ns);
        let at_robot = match &input {
            Input::RobotDatagram { from, bytes } => PortInput::Datagram {
                port: Port::Robot,
                from: *from,
                bytes: bytes.clone(),
            },
            Input::RobotPort(input) => input.clone(),
            Input::Panel(panel) => PortInput::Panel(*panel),
            _ => PortInput::Wake,
        };
        self.robot.handle_input(now_ns, at_robot);
        match input {
            Input::CameraConnected { connection } => self.camera.handle_connected(now_ns, connection),
            Input::CameraAddress { connection, address } => self.camera.handle_address(connection, address),
            Input::CameraBytes { connection, bytes } => self.camera.handle_bytes(now_ns, connection, &bytes),
            Input::CameraClosed { connection } => self.camera.handle_closed(now_ns, connection),
            Input::Rendered { job, frame } => self.take_frame(now_ns, job, frame),
            Input::RobotDatagram { .. } | Input::RobotPort(_) | Input::Panel(_) | Input::Wake => (),
        }
        self.drain_camera(now_ns);
        while let Some(output) = self.robot.poll_output() {
            self.outputs.push_back(match output {
                PortOutput::Datagram {
                    port: Port::Robot,
                    to,
                    bytes,
                } => Output::RobotDatagram { to, bytes },
                PortOutput::Violation(text) => Output::Violation(text),
                other => Output::RobotPort(other),
            });
        }
    }

    /// Says good-bye to the camera's clients.
    pub fn shut_down(&mut self, now_ns: u64) {
        self.camera.shut_down();
        self.drain_camera(now_ns);
    }

    /// Next thing to do.
    pub fn poll_output(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// When [`Input::Wake`] has something to do.
    pub fn wake_at(&self) -> Option<u64> {
        self.camera.wake_at().into_iter().chain(self.robot.wake_at()).min()
    }

    /// From here on [`Cell::poll_passed`] tells what comes over the serial line.
    pub fn watch_serial(&mut self) {
        self.robot.watch_serial();
    }

    /// Next character that has come over the serial line.
    pub fn poll_passed(&mut self) -> Option<Passed> {
        self.robot.poll_passed()
    }

    /// Faults of the camera's triggers that have happened so far.
    pub fn met_camera_faults(&self) -> Vec<CameraFault> {
        self.camera.met_faults()
    }

    /// The robot controller, to look at.
    pub fn robot(&mut self) -> &mut Controller {
        self.robot.controller()
    }

    /// Everything true so far.
    pub fn truth(&self) -> &Truth {
        &self.truth
    }

    fn drain_camera(&mut self, now_ns: u64) {
        while let Some(output) = self.camera.poll_output() {
            match output {
                DeviceOutput::Bytes { connection, bytes } => {
                    self.outputs.push_back(Output::CameraBytes { connection, bytes });
                }
                DeviceOutput::Close { connection } => self.outputs.push_back(Output::CameraClose { connection }),
                DeviceOutput::Violation(text) => self.outputs.push_back(Output::Violation(text)),
                DeviceOutput::Expose {
                    job,
                    trigger_id,
                    capture,
                } => self.expose(now_ns, job, trigger_id, capture),
                DeviceOutput::Exposed { job } => self.end_exposure(now_ns, job),
            }
        }
    }

    fn expose(&mut self, now_ns: u64, job: u64, trigger_id: u64, capture: Capture) {
        let base_from_tool = self.robot.controller().pose(now_ns).to_isometry();
        let camera_from_blade = camera_from_blade(&self.scene, &base_from_tool, trigger_id);
        let exposure = Exposure {
            trigger_id,
            camera_from_blade,
            was_moving: self.robot.controller().is_moving(now_ns),
            departure_count: self.robot.controller().departure_count(),
            moved: None,
            surface_points_mm: None,
        };
        // What was aborted while it was exposed has no truth.
        self.exposures.retain(|_, earlier| earlier.moved.is_some());
        self.exposures.insert(job, exposure);
        self.outputs.push_back(Output::Render(RenderJob {
            job,
            optics: self.scene.optics,
            camera_from_blade,
            capture,
            draws: Draws {
                seed: self.scene.seed,
                trigger_id,
            },
        }));
    }

    fn end_exposure(&mut self, now_ns: u64, job: u64) {
        if let Some(exposure) = self.exposures.get_mut(&job) {
            let has_moved = self.robot.controller().is_moving(now_ns)
                || self.robot.controller().departure_count() != exposure.departure_count;
            exposure.moved = Some(exposure.was_moving || has_moved);
        }
        self.record(job);
    }

    fn take_frame(&mut self, now_ns: u64, job: u64, frame: Frame) {
        if let Some(exposure) = self.exposures.get_mut(&job) {
            exposure.surface_points_mm = Some(frame.surface_points_mm.clone());
        }
        self.camera.handle_frame(now_ns, job, frame);
        self.record(job);
    }

    /// Records the truth of an acquisition that is exposed and rendered. One that was aborted earlier never is.
    fn record(&mut self, job: u64) {
        let is_complete =
            |_: &u64, exposure: &mut Exposure| exposure.moved.is_some() && exposure.surface_points_mm.is_some();
        for (_, exposure) in self.exposures.extract_if(..=job, is_complete) {
            self.truth.record(
                exposure.trigger_id,
                &exposure.camera_from_blade,
                exposure.surface_points_mm.unwrap_or_default(),
                exposure.moved.unwrap_or_default(),
            );
            self.outputs.push_back(Output::TruthGrew);
        }
    }
}

/// True pose of the blade before the camera: the calibrated transforms and the reported pose, each with its error. The
/// errors come from the seed and, for the robot's, from the trigger id alone.
fn camera_from_blade(scene: &Scene, base_from_tool: &Isometry3<f64>, trigger_id: u64) -> Isometry3<f64> {
    let size = &scene.pose_error;
    let calibration = |which| {
        calibration_error(
            scene.seed,
            which,
            size.calibration_mm,
            size.calibration_deg.to_radians(),
        )
    };
    let reported_from_true = pose_error(scene.seed, trigger_id, size.robot_mm, size.robot_deg.to_radians());
    let base_from_camera = scene.base_from_camera * calibration(WHICH_CAMERA);
    let tool_from_blade = scene.tool_from_blade * calibration(WHICH_BLADE);
    base_from_camera.inverse() * base_from_tool * reported_from_true * tool_from_blade
}

const WHICH_CAMERA: u64 = 0;
const WHICH_BLADE: u64 = 1;

#[cfg(test)]
#[path = "cell_tests.rs"]
mod tests;
