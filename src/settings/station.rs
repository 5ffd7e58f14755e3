//! Stations: where it is measured, by which devices, within which limits.

use std::fmt;
use std::path::PathBuf;

use nalgebra::{Isometry3, Point3};
use toml::Spanned;

use super::error::SettingsError;
use super::keys::STATION_KEYS;
use super::source::Source;
use super::written::{CameraLinkFile, KindFile, LinkFile, MotionFile, RobotFile, StationFile, WorkspaceFile};
use crate::robot::JobName;

/// Where it is measured: devices, limits, time-outs and calibration of one cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Station {
    /// 1 to 64 letters, digits, dots, hyphens and underscores.
    pub name: String,
    /// What is at the other end of the wires.
    pub target: Target,
    /// Limits and time-outs of the robot.
    pub robot: RobotLink,
    /// Time-outs of the camera.
    pub camera: CameraLink,
    /// Names the calibration in recordings; never empty.
    pub calibration_id: String,
    /// The fixed camera in the robot's base frame (hand-eye calibration), in mm.
    pub base_from_camera: Isometry3<f64>,
    /// The blade in the robot's tool frame (how it is gripped), in mm.
    pub tool_from_blade: Isometry3<f64>,
}

/// What is at the other end of the wires.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// A simulated cell that the caller starts; it says on which ports it listens.
    Simulated,
    /// A simulated cell that runs already.
    SimulatedAt {
        /// The robot.
        robot: RobotAddress,
        /// The camera's port.
        camera: HostPort,
    },
    /// Real devices.
    Cell {
        /// The robot.
        robot: RobotAddress,
        /// The bridge to the camera.
        camera: HostPort,
    },
}

/// Where the robot is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RobotAddress {
    /// Its High-Speed Ethernet Server, UDP.
    Hses(HostPort),
    /// Its host control, TCP.
    HostControl(HostPort),
    /// At the end of a serial cable.
    Serial {
        /// The path of the port.
        device: PathBuf,
        /// Bits per second, 150 to 115,200.
        baud: u32,
    },
}

/// What is spoken with the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RobotProtocol {
    /// High-Speed Ethernet Server, UDP.
    Hses,
    /// Host control, TCP.
    HostControl,
    /// Host control, BSC-LIKE over a serial line.
    Serial {
        /// Bits per second, 150 to 115,200.
        baud: u32,
    },
}

/// How the robot is moved.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Motion {
    /// By moves that are sent one by one.
    Direct,
    /// By orders to a job on the controller (`docs/robot/README.md`).
    Job(ScanJob),
}

/// The job on the controller, and the variables that it shares with us.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScanJob {
    /// Its name there.
    pub name: JobName,
    /// The first position variable for poses of the plan, 0 to 999.
    pub position_first: u16,
    /// The last one, not below the first.
    pub position_last: u16,
    /// The first of its D variables, 0 to 999.
    pub variable_first: u16,
    /// How long it waits for a sign of life, 1 s to 10 min.
    pub patience_ns: u64,
}

impl ScanJob {
    /// How many poses fit.
    pub fn position_count(&self) -> usize {
        usize::from(self.position_last - self.position_first) + 1
    }
}

/// A host name or IP address, and a port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HostPort {
    /// Name or address without brackets; never empty.
    pub host: String,
    /// 1 to 65535.
    pub port: u16,
}

impl HostPort {
    /// Reads `HOST:PORT`, with an IPv6 address in brackets: `[::1]:10040`.
    pub fn parse(text: &str) -> Option<Self> {
        let (host, port) = text.rsplit_once(':')?;
        let bare_host = match host.strip_prefix('[') {
            Some(rest) => rest.strip_suffix(']')?,
            None if host.contains(':') => return None,
            None => host,
        };
        let host_is_plain = bare_host
            .chars()
            .all(|letter| letter.is_ascii_alphanumeric() || ".-_:".contains(letter));
        let port_is_plain = port.chars().all(|digit| digit.is_ascii_digit());
        let port = port.parse().ok().filter(|port| *port != 0)?;
        (!bare_host.is_empty() && host_is_plain && port_is_plain).then(|| Self {
            host: bare_host.to_owned(),
            port,
        })
    }
}

impl fmt::Display for HostPort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.host.contains(':') {
            write!(f, "[{}]:{}", self.host, self.port)
        } else {
            write!(f, "{}:{}", self.host, self.port)
        }
    }
}

/// Limits and time-outs of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotLink {
    /// What is spoken.
    pub protocol: RobotProtocol,
    /// How the robot is moved.
    pub motion: Motion,
    /// The tool whose frame the calibration means, 0 to 63.
    pub tool: u8,
    /// Speed of straight moves, 0.1 to 1500 mm/s.
    pub speed_mm_s: f64,
    /// Speed of turns, 0.1 to 180 deg/s in rad/s.
    pub rotation_speed_rad_s: f64,
    /// How long one request may stay unanswered, 1 ms to 10 s.
    pub answer_timeout_ns: u64,
    /// How often a question is asked before the robot counts as silent, 1 to 20.
    pub ask_attempts: u32,
    /// Time between two status requests during a move, 1 ms to 1 s.
    pub poll_interval_ns: u64,
    /// How long a move may take to start, 0 to 10 s.
    pub start_grace_ns: u64,
    /// How long a move may take, 100 ms to 1 h.
    pub move_timeout_ns: u64,
    /// Rest between the end of a move and the trigger, 0 to 10 s.
    pub settle_ns: u64,
    /// How long the servos may take to switch, 100 ms to 1 min.
    pub servo_timeout_ns: u64,
    /// Time between two holds while one is not yet confirmed, 1 ms to 10 s.
    pub hold_repeat_ns: u64,
    /// How long a hold may stay unconfirmed, 100 ms to 1 min.
    pub hold_timeout_ns: u64,
    /// Largest distance between commanded and reported position, 0.001 to 10 mm.
    pub position_tolerance_mm: f64,
    /// Largest angle between commanded and reported orientation, 0.0001° to 5° in rad.
    pub rotation_tolerance_rad: f64,
    /// The largest angle between two poses of a plan, 0.1° to 180° in rad.
    pub step_angle_max_rad: f64,
    /// Where the tool may be.
    pub workspace: Workspace,
}

/// The box in the robot's base frame in which the origin of the tool frame must stay, edges included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Workspace {
    /// The corner with the least coordinates, in mm.
    pub min_mm: Point3<f64>,
    /// The corner with the greatest coordinates, in mm; above `min_mm` in each.
    pub max_mm: Point3<f64>,
}

/// Time-outs of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CameraLink {
    /// How long the connection may take, 1 ms to 1 min.
    pub connect_timeout_ns: u64,
    /// How long one request may stay unanswered, 1 ms to 1 min.
    pub reply_timeout_ns: u64,
    /// How much longer than predicted by the camera a frame may take, 0 to 10 min.
    pub frame_timeout_extra_ns: u64,
    /// Time between two pings of a quiet connection, 1 ms to 1 min.
    pub ping_interval_ns: u64,
    /// A connection silent for this long is dead, above the ping interval, up to 10 min.
    pub dead_after_ns: u64,
    /// How long a lost connection is opened again, 0 to 1 h; 0: not at all.
    pub reconnect_timeout_ns: u64,
    /// How long a camera that is too hot or in use by another program is waited for, 0 to 1 h.
    pub device_timeout_ns: u64,
}

impl Station {
    /// Reads a station from its text. `file_name` is only for errors; nothing is opened.
    ///
    /// # Errors
    ///
    /// One mistake in the text: broken TOML, an unknown or missing key, a wrong type, a value out of its range, or
    /// two keys that contradict each other.
    pub fn parse(file_name: &str, text: &str) -> Result<Self, SettingsError> {
        let source = Source::new(file_name, text, STATION_KEYS);
        let written: StationFile = source.written()?;
        let target = target(&source, &written)?;
        let calibration = written.calibration;
        Ok(Self {
            name: name_is_plain(&source, "name", written.name)?,
            target,
            robot: robot_link(&source, &written.robot)?,
            camera: camera_link(&source, &written.camera)?,
            calibration_id: not_empty(&source, "calibration.id", calibration.id)?,
            base_from_camera: calibration.base_from_camera.isometry(),
            tool_from_blade: calibration.tool_from_blade.isometry(),
        })
    }

    /// The station of the built-in simulated cell, the text of `config/stations/sim.toml`.
    pub fn builtin_simulated() -> Self {
        Self::parse("config/stations/sim.toml", Self::BUILTIN_SIMULATED_TEXT).expect("the built-in station is tested")
    }

    /// The text that [`Station::builtin_simulated`] reads.
    pub const BUILTIN_SIMULATED_TEXT: &str = include_str!("../../config/stations/sim.toml");
}

fn target(source: &Source, written: &StationFile) -> Result<Target, SettingsError> {
    let (robot, camera) = (&written.robot, &written.camera);
    let place = match robot.link {
        LinkFile::Serial => &robot.serial_device,
        LinkFile::Hses | LinkFile::HostControl => &robot.address,
    };
    // A simulated cell that the caller starts chooses its ports itself; one that runs elsewhere has addresses.
    if matches!(written.kind, KindFile::Simulated) && place.is_none() && camera.address.is_none() {
        return Ok(Target::Simulated);
    }
    let network = || host_port(source, "robot.address", place, "192.168.1.31:10040");
    let robot = match (&robot.link, place) {
        (LinkFile::Hses, _) => RobotAddress::Hses(network()?),
        (LinkFile::HostControl, _) => RobotAddress::HostControl(network()?),
        (LinkFile::Serial, Some(device)) => RobotAddress::Serial {
            device: PathBuf::from(device.get_ref()),
            baud: robot.serial_baud,
        },
        (LinkFile::Serial, None) => {
            let message = "`robot.serial_device` is missing: a serial link needs the port's path".to_owned();
            let help = Some("for example \"/dev/ttyUSB0\"".to_owned());
            return Err(source.error_at_key("robot.serial_device", message, help));
        }
    };
    let camera = host_port(source, "camera.address", &camera.address, "127.0.0.1:50555")?;
    Ok(match written.kind {
        KindFile::Simulated => Target::SimulatedAt { robot, camera },
        KindFile::Cell => Target::Cell { robot, camera },
    })
}

fn motion(source: &Source, written: &RobotFile) -> Result<Motion, SettingsError> {
    let job = &written.job;
    let name = JobName::parse(job.name.get_ref()).map_err(|error| {
        let message = format!("`robot.job.name`: {error}");
        source.error_in_value("robot.job.name", job.name.span(), message)
    })?;
    let last = *job.position_last.get_ref();
    if last < job.position_first {
        let message = format!(
            "`robot.job.position_last` is {last}, below `position_first` of {}",
            job.position_first
        );
        return Err(source.error_in_value("robot.job.position_last", job.position_last.span(), message));
    }
    Ok(match written.motion {
        MotionFile::Direct => Motion::Direct,
        MotionFile::Job => Motion::Job(ScanJob {
            name,
            position_first: job.position_first,
            position_last: last,
            variable_first: job.variable_first,
            patience_ns: job.patience_ms * NS_PER_MS,
        }),
    })
}

fn host_port(
    source: &Source,
    path: &str,
    written: &Option<Spanned<String>>,
    example: &str,
) -> Result<HostPort, SettingsError> {
    let help = Some(format!("HOST:PORT with a port from 1 to 65535, as in \"{example}\""));
    let Some(written) = written else {
        let message = format!(
            "`{path}` is missing: a station needs both addresses, unless it is the simulated one that a dry run starts"
        );
        return Err(source.error_at_key(path, message, help));
    };
    HostPort::parse(written.get_ref()).ok_or_else(|| {
        let message = format!("`{path}` is \"{}\", which is no address", written.get_ref());
        source.error(written.span(), message, help)
    })
}

fn robot_link(source: &Source, written: &RobotFile) -> Result<RobotLink, SettingsError> {
    let protocol = match written.link {
        LinkFile::Hses => RobotProtocol::Hses,
        LinkFile::HostControl => RobotProtocol::HostControl,
        LinkFile::Serial => RobotProtocol::Serial {
            baud: written.serial_baud,
        },
    };
    Ok(RobotLink {
        protocol,
        motion: motion(source, written)?,
        tool: written.tool,
        speed_mm_s: written.speed_mm_s,
        rotation_speed_rad_s: written.rotation_speed_deg_s.to_radians(),
        answer_timeout_ns: written.answer_timeout_ms * NS_PER_MS,
        ask_attempts: written.ask_attempts,
        poll_interval_ns: written.poll_interval_ms * NS_PER_MS,
        start_grace_ns: written.start_grace_ms * NS_PER_MS,
        move_timeout_ns: written.move_timeout_ms * NS_PER_MS,
        settle_ns: written.settle_ms * NS_PER_MS,
        servo_timeout_ns: written.servo_timeout_ms * NS_PER_MS,
        hold_repeat_ns: written.hold_repeat_ms * NS_PER_MS,
        hold_timeout_ns: written.hold_timeout_ms * NS_PER_MS,
        position_tolerance_mm: written.position_tolerance_mm,
        rotation_tolerance_rad: written.rotation_tolerance_deg.to_radians(),
        step_angle_max_rad: written.step_angle_max_deg.to_radians(),
        workspace: workspace(source, &written.workspace)?,
    })
}

fn workspace(source: &Source, written: &WorkspaceFile) -> Result<Workspace, SettingsError> {
    let (min_mm, max_mm) = (written.min_mm, *written.max_mm.get_ref());
    if let Some(axis) = (0..3).find(|&axis| max_mm[axis] <= min_mm[axis]) {
        let message = format!(
            "`robot.workspace.max_mm[{axis}]` is {} mm, not above `min_mm[{axis}]` of {} mm",
            max_mm[axis], min_mm[axis]
        );
        return Err(source.error_in_value("robot.workspace.max_mm", written.max_mm.span(), message));
    }
    Ok(Workspace {
        min_mm: min_mm.into(),
        max_mm: max_mm.into(),
    })
}

fn camera_link(source: &Source, written: &CameraLinkFile) -> Result<CameraLink, SettingsError> {
    let dead_after_ms = *written.dead_after_ms.get_ref();
    if dead_after_ms <= written.ping_interval_ms {
        let message = format!(
            "`camera.dead_after_ms` is {dead_after_ms} ms, not above `ping_interval_ms` of {} ms",
            written.ping_interval_ms
        );
        return Err(source.error_in_value("camera.dead_after_ms", written.dead_after_ms.span(), message));
    }
    Ok(CameraLink {
        connect_timeout_ns: written.connect_timeout_ms * NS_PER_MS,
        reply_timeout_ns: written.reply_timeout_ms * NS_PER_MS,
        frame_timeout_extra_ns: written.frame_timeout_extra_ms * NS_PER_MS,
        ping_interval_ns: written.ping_interval_ms * NS_PER_MS,
        dead_after_ns: dead_after_ms * NS_PER_MS,
        reconnect_timeout_ns: written.reconnect_timeout_ms * NS_PER_MS,
        device_timeout_ns: written.device_timeout_ms * NS_PER_MS,
    })
}

/// A name that can be part of a file name everywhere.
pub(super) fn name_is_plain(source: &Source, path: &str, name: Spanned<String>) -> Result<String, SettingsError> {
    let text = name.get_ref();
    let plain = (1..=64).contains(&text.len())
        && text
            .chars()
            .all(|letter| letter.is_ascii_alphanumeric() || ".-_".contains(letter));
    if plain {
        Ok(name.into_inner())
    } else {
        let message = format!("`{path}` is {text:?}, which cannot name files");
        Err(source.error_in_value(path, name.span(), message))
    }
}

fn not_empty(source: &Source, path: &str, text: Spanned<String>) -> Result<String, SettingsError> {
    if text.get_ref().is_empty() {
        Err(source.error_in_value(path, text.span(), format!("`{path}` is empty")))
    } else {
        Ok(text.into_inner())
    }
}

const NS_PER_MS: u64 = 1_000_000;
