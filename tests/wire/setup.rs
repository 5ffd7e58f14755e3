//! What a run depends on, and what is seen of it.

use super::carry::Weather;
use bladescan::session::{ArmEvent, ArmSettings, JobSettings, Motion, exchange_settings};
use bladescan::settings::{RobotProtocol, Station};
use hw_sim::fault::Fault;
use hw_sim::robot::controller::Panel;
use nalgebra::{Isometry3, Translation3, UnitQuaternion};

/// What carries the conversation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Link {
    /// Datagrams.
    Hses,
    /// Host control over TCP.
    HostControl,
    /// Host control over a serial line.
    Serial,
}

/// How the arm is moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// By moves of its own.
    Direct,
    /// By orders to the scan job.
    Job,
}

/// Part of a run, as it is seen from outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// The controller is asked who it is.
    Identifying,
    /// The state is being put right.
    Readying,
    /// Servo power is being switched on.
    ServoOn,
    /// Poses are being put on the controller.
    Loading,
    /// The scan job is being started.
    Starting,
    /// The arm moves.
    Moving,
    /// It has come to rest, and its arrival is not told yet.
    Settling,
    /// It stands at a pose.
    Standing,
    /// It is held.
    Held,
    /// It is made ready after a hold.
    Resuming,
    /// It is let go.
    Parking,
}

/// When something happens in the cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum When {
    /// At this time of the run, ns.
    At(u64),
    /// When this part of the run is seen first.
    In(Phase),
    /// This long after the incident before it, ns.
    After(u64),
}

/// Something that happens in the cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Happening {
    /// A person at the robot.
    Panel(Panel),
    /// The operator at bladescan holds.
    OperatorHold,
    /// The connection breaks.
    Cut,
}

/// Something that happens to single datagrams; they are counted from 0 on their way to the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tamper {
    /// This one gets lost.
    Lose {
        /// Which.
        index: usize,
    },
    /// This one comes a second time.
    Again {
        /// Which.
        index: usize,
        /// So much later, ns.
        late_ns: u64,
    },
    /// Every answer within this time gets lost.
    Deaf {
        /// First time, ns.
        from_ns: u64,
        /// First time after it, ns.
        to_ns: u64,
    },
}

/// Everything that one run depends on.
#[derive(Debug, Clone)]
pub struct Setup {
    /// What carries the conversation.
    pub link: Link,
    /// How the arm is moved.
    pub way: Way,
    /// How many poses.
    pub target_count: usize,
    /// What the wire does.
    pub weather: Weather,
    /// What happens to single datagrams.
    pub tampers: Vec<Tamper>,
    /// Faults of the simulator itself.
    pub faults: Vec<Fault>,
    /// What happens in the cell, in order.
    pub incidents: Vec<(When, Happening)>,
    /// How long the arm stands at each pose, ns.
    pub exposure_ns: u64,
    /// Seed of all chance.
    pub seed: u64,
}

/// How a run has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Ended {
    /// Every target reached, the arm let go.
    Finished,
    /// In a fault that has a name, the arm let go.
    Fault(&'static str),
    /// Neither within twenty minutes.
    Hung,
}

/// What was seen of a run.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// How it has ended.
    pub ended: Ended,
    /// When, ns.
    pub end_ns: u64,
    /// Motions begun beyond the one that an order may begin.
    pub repeated_count: u32,
    /// Motions begun while the arm was told to be held, or going on then.
    pub moved_while_held_count: u32,
    /// Arrivals told while the arm moved or stood elsewhere.
    pub wrong_arrival_count: u32,
    /// What the simulator says of our bytes.
    pub violations: Vec<String>,
    /// Of all bytes both ways, with their times.
    pub digest: u64,
    /// What the arm told, and when, ns.
    pub events: Vec<(u64, ArmEvent)>,
    /// When the incidents happened, ns.
    pub incident_ns: Vec<u64>,
    /// Command and time, ns, of every datagram to the robot.
    pub sent: Vec<(u16, u64)>,
}

impl Outcome {
    /// Whether nothing happened that never may.
    pub fn is_sound(&self) -> bool {
        self.ended != Ended::Hung
            && (
                self.repeated_count,
                self.moved_while_held_count,
                self.wrong_arrival_count,
            ) == (0, 0, 0)
    }
}

/// Those of the built-in station, but slower turns.
pub fn arm_settings(setup: &Setup) -> ArmSettings {
    let mut station = Station::builtin_simulated();
    station.robot.protocol = match setup.link {
        Link::Hses => RobotProtocol::Hses,
        Link::HostControl => RobotProtocol::HostControl,
        Link::Serial => RobotProtocol::Serial { baud: 9600 },
    };
    let robot = &station.robot;
    let ms = |ns: u64| ns / 1_000_000;
    ArmSettings {
        motion: match setup.way {
            Way::Direct => Motion::Direct,
            Way::Job => Motion::Job(JobSettings {
                name: bladescan::robot::JobName::parse("BLADESCAN").expect("a good name"),
                position_first: 10,
                variable_first: 10,
                patience: JOB_PATIENCE,
            }),
        },
        tool: robot.tool,
        speed_mm_s: robot.speed_mm_s,
        rotation_speed_rad_s: 20.0_f64.to_radians(),
        poll_interval_ms: ms(robot.poll_interval_ns),
        start_grace_ms: ms(robot.start_grace_ns),
        move_timeout_ms: ms(robot.move_timeout_ns),
        settle_ms: ms(robot.settle_ns),
        servo_timeout_ms: ms(robot.servo_timeout_ns),
        position_tolerance_mm: robot.position_tolerance_mm,
        rotation_tolerance_rad: robot.rotation_tolerance_rad,
        exchange: exchange_settings(&station),
    }
}

/// Turns of 10 degrees with tilts of a few, as a plan has them.
pub fn targets(count: usize, seed: u64) -> Vec<Isometry3<f64>> {
    (0..count)
        .map(|index| {
            let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, (10.0 * (index + 1) as f64).to_radians());
            let tilt_deg = (seed % 7) as f64 - 3.0;
            let tilt = UnitQuaternion::from_euler_angles((tilt_deg * (index % 3) as f64).to_radians(), 0.0, 0.0);
            Isometry3::from_parts(Translation3::new(1000.0, 0.0, 900.0), turn * tilt)
        })
        .collect()
}

/// Thirty seconds.
const JOB_PATIENCE: i32 = 1500;
