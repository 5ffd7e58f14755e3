//! The simulated cell as a child process of the same executable.

use super::live::{Links, RobotPlace};
use nalgebra::Isometry3;
use serde::Deserialize;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};
use std::time::Duration;
use thiserror::Error;
use tokio::io::{AsyncBufReadExt as _, BufReader};
use tokio::process::{Child, Command};

use crate::geometry::fixed_xyz_from_rotation;
use crate::settings::RobotProtocol;

/// What the simulated cell is to be.
#[derive(Debug, Clone)]
pub struct SimulatedOptions {
    /// Seeds everything drawn.
    pub seed: u64,
    /// `builtin:NAME` or the path of an STL file.
    pub blade: String,
    /// The lens set.
    pub optics: &'static str,
    /// How the blade throws light back: the name of a preset.
    pub surface: String,
    /// Parts of the camera's artefacts to leave out.
    pub without: Vec<String>,
    /// Whether it has a serial line (a pseudo-terminal).
    pub serial: bool,
    /// Where the camera stands, mm.
    pub base_from_camera: Isometry3<f64>,
    /// How the blade is gripped, mm.
    pub tool_from_blade: Isometry3<f64>,
    /// Scales motion and exposure.
    pub speed: f64,
    /// Where the truth is written.
    pub truth: PathBuf,
    /// Faults to inject.
    pub faults: Vec<String>,
}

/// Why the simulated cell did not come up.
#[derive(Debug, Error)]
pub enum SimulatedError {
    /// The child process.
    #[error("cannot start the simulated cell: {0}")]
    Start(io::Error),
    /// Its options, for example a fault it does not know; it has said why.
    #[error("the simulated cell did not take its options ({0})")]
    Options(ExitStatus),
    /// No line with its addresses came.
    #[error("the simulated cell did not say where it listens")]
    NotReady,
}

/// A running simulated cell. It ends when its standard input does, that is, at the latest when this process dies.
pub struct SimulatedCell {
    child: Child,
    ready: Ready,
}

/// Where the cell listens.
#[derive(Deserialize)]
struct Ready {
    hses: SocketAddr,
    host_control: Option<SocketAddr>,
    serial: Option<PathBuf>,
    a3dp: SocketAddr,
}

impl SimulatedCell {
    /// Starts it and waits until it listens.
    pub async fn start(options: &SimulatedOptions) -> Result<Self, SimulatedError> {
        let program = std::env::current_exe().map_err(SimulatedError::Start)?;
        let mut command = Command::new(program);
        command
            .args(["sim", "cell", "--json", "--until-stdin-closes"])
            .arg(format!("--seed={}", options.seed))
            .arg(format!("--blade={}", options.blade))
            .arg(format!("--optics={}", options.optics))
            .arg(format!("--surface={}", options.surface))
            .args(options.without.iter().map(|term| format!("--without={term}")))
            .arg(format!("--base-from-camera={}", pose_words(&options.base_from_camera)))
            .arg(format!("--tool-from-blade={}", pose_words(&options.tool_from_blade)))
            .arg(format!("--speed={}", options.speed))
            .arg("--truth")
            .arg(&options.truth)
            .arg("--host-control-pause=0")
            .args(options.serial.then_some("--serial"))
            .args(options.faults.iter().map(|fault| format!("--fault={fault}")))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .kill_on_drop(true);
        // Ctrl-C is for the run to handle, not for its cell.
        #[cfg(unix)]
        command.process_group(0);
        let mut child = command.spawn().map_err(SimulatedError::Start)?;
        let stdout = child.stdout.take().ok_or(SimulatedError::NotReady)?;
        let mut line = String::new();
        let mut lines = BufReader::new(stdout);
        let reading = tokio::time::timeout(READY_TIMEOUT, lines.read_line(&mut line));
        if !matches!(reading.await, Ok(Ok(length)) if length > 0) {
            return match tokio::time::timeout(READY_TIMEOUT, child.wait()).await {
                Ok(Ok(status)) => Err(SimulatedError::Options(status)),
                _ => Err(SimulatedError::NotReady),
            };
        }
        let ready = serde_json::from_str(&line).map_err(|_| SimulatedError::NotReady)?;
        Ok(Self { child, ready })
    }

    /// Where its devices are for someone who speaks `protocol` with the robot; `None` if the cell does not.
    pub fn links(&self, protocol: RobotProtocol) -> Option<Links> {
        let robot = match protocol {
            RobotProtocol::Hses => RobotPlace::Hses(self.ready.hses),
            RobotProtocol::HostControl => RobotPlace::HostControl(self.ready.host_control?),
            RobotProtocol::Serial { baud } => RobotPlace::Serial {
                device: self.ready.serial.clone()?,
                baud,
            },
        };
        let camera = self.ready.a3dp;
        Some(Links { robot, camera })
    }

    /// Lets it end, so that its truth is written to the last view.
    pub async fn stop(mut self) {
        drop(self.child.stdin.take());
        if tokio::time::timeout(STOP_TIMEOUT, self.child.wait()).await.is_err() {
            self.child.kill().await.ok();
        }
    }
}

/// `x,y,z,rx,ry,rz` in mm and degrees about fixed axes.
fn pose_words(pose: &Isometry3<f64>) -> String {
    let position = pose.translation.vector;
    let [rx, ry, rz] = fixed_xyz_from_rotation(&pose.rotation).map(f64::to_degrees);
    format!("{},{},{},{rx},{ry},{rz}", position.x, position.y, position.z)
}

const READY_TIMEOUT: Duration = Duration::from_secs(30);
const STOP_TIMEOUT: Duration = Duration::from_secs(10);
