//! Moves, in bytes.

use super::*;

fn cartesian(instance: u16, coordinate: i32, pose: [i32; 6], class: i32) -> Vec<u8> {
    let mut words = [0; 26];
    (words[0], words[2], words[3], words[4], words[15]) = (1, class, 1000, coordinate, 1);
    words[5..11].copy_from_slice(&pose);
    frame(0x8A, instance, 1, SERVICE_SET_ALL, &bytes_of(&words))
}

#[test]
fn every_kind_of_move_ends_where_it_says() {
    let mut robot = ready();
    let mut now_ns = 0;
    let mut go = |bytes: &[u8], pulses: [i32; 6]| {
        let (answer, _) = send(&mut robot, now_ns, bytes);
        assert_eq!(answer[25], 0, "{answer:x?}");
        assert!(robot.is_moving(now_ns));
        now_ns += 60 * SECOND_NS;
        assert_eq!(robot.pose(now_ns).to_pulses(), pulses);
    };
    go(
        &cartesian(1, 16, [500_000, 0, 900_000, 0, 0, 900_000], 0),
        [500_000, 0, 900_000, 0, 0, 900_000],
    );
    go(
        &cartesian(2, 17, [500_000, 0, 800_000, 0, 0, 900_000], 1),
        [500_000, 0, 800_000, 0, 0, 900_000],
    );
    go(
        &cartesian(3, 16, [10_000, 0, 0, 0, 0, -450_000], 1),
        [510_000, 0, 800_000, 0, 0, 450_000],
    );
    go(
        &cartesian(3, 16, [0, 0, 0, 0, 0, 450_000], 2),
        [510_000, 0, 800_000, 0, 0, 900_000],
    );
    // In the tool, whose x is the base's y now.
    go(
        &cartesian(3, 19, [10_000, 0, 0, 0, 0, 0], 1),
        [510_000, 10_000, 800_000, 0, 0, 900_000],
    );
    let mut words = [0; 22];
    (words[0], words[3], words[12]) = (1, 500, 1);
    words[4..10].copy_from_slice(&[1000, -2000, 3000, 4000, 5000, -6000]);
    let pulses = frame(0x8B, 1, 1, SERVICE_SET_ALL, &bytes_of(&words));
    go(&pulses, [1000, -2000, 3000, 4000, 5000, -6000]);
    assert_eq!(robot.accepted_move_count(), 6);
}

#[test]
fn moves_that_cannot_be_are_refused() {
    let mut robot = ready();
    let mut refused = |bytes: &[u8]| {
        let (answer, _) = send(&mut robot, 0, bytes);
        (answer[25], u16::from_le_bytes([answer[28], answer[29]]))
    };
    assert_eq!(refused(&cartesian(3, 18, [0; 6], 1)), (0x1F, 0xB00B));
    assert_eq!(refused(&cartesian(2, 19, [0; 6], 1)), (0x1F, 0xB00B));
    assert_eq!(refused(&cartesian(3, 16, [i32::MAX; 6], 1)), (0x1F, 0xB004));
    assert_eq!(
        refused(&cartesian(3, 16, [3_000_000, 0, 0, 0, 0, 0], 1)),
        (0x1F, 0xB004)
    );
    assert_eq!(refused(&cartesian(4, 16, [0; 6], 1)).0, 0x28);
    for (index, value, code) in [
        (1, 1, 0xB008),
        (3, 0, 0xB00A),
        (12, 64, 0xB00D),
        (4, 3_000_000, 0xB004),
        (10, 1, 0xB004),
        (13, 1, 0xB004),
    ] {
        let mut words = [0; 22];
        (words[0], words[3]) = (1, 500);
        words[index] = value;
        let bytes = frame(0x8B, 2, 1, SERVICE_SET_ALL, &bytes_of(&words));
        assert_eq!(refused(&bytes), (0x1F, code), "{index}");
    }
    assert_eq!(refused(&frame(0x8B, 3, 1, SERVICE_SET_ALL, &[])).0, 0x28);
    assert_eq!(refused(&frame(0x8B, 1, 1, SERVICE_SET_ALL, &[0; 84])), (0x1F, 0xB003));
}

#[test]
fn a_form_that_the_arm_has_is_taken_and_another_refused() {
    let mut robot = ready();
    for (form, status) in [(0x7F, 0), (0x80 | 4, 0), (0x80, 0x1F), (0x100, 0x1F)] {
        let mut bytes = cartesian(2, 16, [800_000, 0, 900_000, 0, 0, 0], 1);
        bytes[32 + 4 * 13..][..4].copy_from_slice(&i32::to_le_bytes(form));
        assert_eq!(send(&mut robot, 0, &bytes).0[25], status, "{form:#x}");
    }
}
