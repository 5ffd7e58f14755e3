//! Error codes of A3DP/1 (section 6 of the page).

macro_rules! codes {
    ($($code:literal $constant:ident $name:literal,)*) => {
        $(#[doc = concat!("`", $name, "`")] pub const $constant: u16 = $code;)*

        /// Its name on the page.
        pub fn name(code: u16) -> Option<&'static str> {
            match code {
                $($code => Some($name),)*
                _ => None,
            }
        }
    };
}

codes! {
    101 BAD_MAGIC "bad_magic",
    102 BAD_HEADER_CRC "bad_header_crc",
    103 BAD_PAYLOAD_CRC "bad_payload_crc",
    104 PAYLOAD_TOO_LONG "payload_too_long",
    105 UNSUPPORTED_VERSION "unsupported_version",
    106 UNKNOWN_TYPE "unknown_type",
    107 SEQUENCE_GAP "sequence_gap",
    108 MALFORMED_PAYLOAD "malformed_payload",
    109 RESERVED_NOT_ZERO "reserved_not_zero",
    201 CONTROLLER_BUSY "controller_busy",
    202 NOT_ARMED "not_armed",
    203 WRONG_STATE "wrong_state",
    204 TRIGGER_IN_FLIGHT "trigger_in_flight",
    205 NO_SESSION "no_session",
    206 WRONG_CONFIG_ID "wrong_config_id",
    207 READ_ONLY "read_only",
    301 OUT_OF_RANGE "out_of_range",
    302 NOT_ON_STEP "not_on_step",
    303 HDR_IN_FREE_RUN "hdr_in_free_run",
    304 UNKNOWN_CRITICAL_TAG "unknown_critical_tag",
    305 MISSING_TAG "missing_tag",
    306 REPEATED_TAG "repeated_tag",
    307 COMPONENT_NOT_OFFERED "component_not_offered",
    401 TRIGGER_MISSED "trigger_missed",
    402 EXPOSURE_TIMEOUT "exposure_timeout",
    403 RECONSTRUCTION_TIMEOUT "reconstruction_timeout",
    404 TOO_FEW_POINTS "too_few_points",
    405 SATURATED "saturated",
    406 ABORTED "aborted",
    407 DEADLINE_PASSED "deadline_passed",
    500 DEVICE_ABNORMAL "device_abnormal",
    501 DEVICE_LOST "device_lost",
    502 OVER_TEMPERATURE "over_temperature",
    503 IN_USE_BY_OTHER_PROCESS "in_use_by_other_process",
    504 RESET_IN_PROGRESS "reset_in_progress",
    505 GPU_UNAVAILABLE "gpu_unavailable",
    601 OVERRUN "overrun",
    602 STORE_MISS "store_miss",
}

#[cfg(test)]
mod tests {
    use super::name;

    #[test]
    fn every_code_has_the_name_that_the_page_gives_it() {
        let page = include_str!("../../docs/protocols/camera.md");
        let section = page.split("## 6. Error codes").nth(1).unwrap();
        let section = section.split("## 7").next().unwrap();
        let mut found = 0;
        for row in section.lines().filter(|line| line.starts_with('|')) {
            let cells: Vec<&str> = row.split('|').map(str::trim).collect();
            for pair in cells.windows(2) {
                if let Ok(code) = pair[0].parse::<u16>() {
                    assert_eq!(name(code), Some(pair[1]));
                    found += 1;
                }
            }
        }
        assert_eq!(found, (0..u16::MAX).filter(|&code| name(code).is_some()).count());
    }
}
