//! Stations: which link, which way to move, and plans that they cannot carry.

use crate::settings::{RECIPE, STATION};
use bladescan::plan::Plan;
use bladescan::seed::Seed;
use bladescan::settings::{Motion, Recipe, RobotAddress, RobotProtocol, Station, Target};

#[test]
fn link_and_way_to_move_are_read_with_what_they_need() {
    let read = |robot: &str| {
        Station::parse(
            "cell.toml",
            &STATION.replace("[robot]\naddress = \"192.168.1.31:10040\"", robot),
        )
    };
    let serial = read("[robot]\nlink = \"serial\"\nserial_device = \"/dev/ttyS1\"\nserial_baud = 19200").unwrap();
    assert_eq!(serial.robot.protocol, RobotProtocol::Serial { baud: 19_200 });
    let Target::Cell { robot, .. } = serial.target else {
        panic!()
    };
    assert_eq!(
        robot,
        RobotAddress::Serial {
            device: "/dev/ttyS1".into(),
            baud: 19_200
        }
    );
    assert_eq!(serial.robot.motion, Motion::Direct);
    let error = read("[robot]\nlink = \"serial\"").unwrap_err();
    assert!(
        error.to_string().contains("`robot.serial_device` is missing"),
        "{error}"
    );
    let by_job =
        read("[robot]\naddress = \"r:80\"\nlink = \"host-control\"\nmotion = \"job\"\njob.position_first = 20")
            .unwrap();
    assert_eq!(by_job.robot.protocol, RobotProtocol::HostControl);
    let Motion::Job(job) = &by_job.robot.motion else {
        panic!()
    };
    assert_eq!(
        (job.name.as_str(), job.position_count(), job.variable_first),
        ("BLADESCAN", 108, 10)
    );
    let error = read("[robot]\naddress = \"r:80\"\njob.position_first = 20\njob.position_last = 19").unwrap_err();
    assert!(error.to_string().contains("below `position_first` of 20"), "{error}");
    let error = read("[robot]\naddress = \"r:80\"\njob.name = \"A B\"").unwrap_err();
    assert!(error.to_string().contains("cannot name a job"), "{error}");
}

#[test]
fn a_plan_the_station_cannot_carry_is_refused_before_anything_is_connected() {
    let plan = |keys: &str| {
        let recipe = Recipe::parse("probe.toml", RECIPE).unwrap();
        let text = STATION.replace("[robot]\n", &format!("[robot]\n{keys}\n"));
        let station = Station::parse("cell.toml", &text).unwrap();
        Plan::new(&recipe, &station, Seed(1)).map(|plan| plan.views().len())
    };
    assert_eq!(plan(""), Ok(36));
    assert_eq!(plan("step_angle_max_deg = 10.0"), Ok(36));
    let error = plan("step_angle_max_deg = 9.9").unwrap_err().to_string();
    assert!(error.contains("view 1: the tool would turn by 10.000°"), "{error}");
    assert_eq!(plan("motion = \"job\"\njob.position_last = 35"), Ok(36));
    let error = plan("motion = \"job\"\njob.position_last = 34")
        .unwrap_err()
        .to_string();
    assert!(error.contains("36 views need as many position variables"), "{error}");
}
