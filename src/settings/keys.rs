//! Every key of recipe and station files: its type, unit, default and range.
//!
//! The reader checks files against these tables, and the tests hold `docs/recipe.md` and `docs/station.md` to them.

use std::fmt;

/// One key that a file may have.
#[derive(Debug, Clone, Copy)]
pub struct Key {
    /// The tables and the key, joined by dots: `camera.exposure_us`. A table that may stand several times (`[[table]]`) ends
    /// in `[]`; its keys have no defaults.
    pub path: &'static str,
    /// What values it takes.
    pub kind: Kind,
    /// What happens without it.
    pub need: Need,
}

/// What values a key takes.
#[derive(Debug, Clone, Copy)]
pub enum Kind {
    /// Text; the field says in words which, and whoever reads the key checks it.
    Text(&'static str),
    /// One of these words.
    Choice(&'static [&'static str]),
    /// Any number of these words.
    Choices(&'static [&'static str]),
    /// `true` or `false`.
    Toggle,
    /// A whole number.
    Integer(Range),
    /// A number.
    Number(Range),
    /// Whole numbers, one or more.
    IntegerList(Range),
    /// This many whole numbers.
    Integers(usize, Range),
    /// This many numbers.
    Numbers(usize, Range),
}

/// What happens without a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Need {
    /// The file is refused.
    Required,
    /// This value, written as TOML, stands in for it.
    Default(&'static str),
    /// The words say what follows from its absence.
    Optional(&'static str),
}

/// The values allowed for a number, both ends included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// The least value.
    pub min: f64,
    /// The greatest value.
    pub max: f64,
    /// The unit as printed; empty for counts, shares and the like.
    pub unit: &'static str,
}

impl Range {
    /// Whether `value` is allowed; NaN never is.
    pub fn contains(&self, value: f64) -> bool {
        (self.min..=self.max).contains(&value)
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {}", self.min, self.max)?;
        if self.unit.is_empty() {
            Ok(())
        } else {
            write!(f, " {}", self.unit)
        }
    }
}

impl Key {
    /// The unit as the documents print it, empty when there is none.
    pub fn unit(&self) -> &'static str {
        match self.kind {
            Kind::Integer(range)
            | Kind::Number(range)
            | Kind::IntegerList(range)
            | Kind::Integers(_, range)
            | Kind::Numbers(_, range) => range.unit,
            Kind::Text(_) | Kind::Choice(_) | Kind::Choices(_) | Kind::Toggle => "",
        }
    }

    /// The default as the documents print it: TOML, "required", or what follows from its absence.
    pub fn default_text(&self) -> &'static str {
        match self.need {
            Need::Required => "required",
            Need::Default(text) | Need::Optional(text) => text,
        }
    }

    /// The allowed values without their unit, as the documents print them.
    pub fn range_text(&self) -> String {
        let bare = |range: Range| Range { unit: "", ..range };
        match self.kind {
            Kind::Text(what) => what.to_owned(),
            Kind::Choice(words) => quoted(words),
            Kind::Choices(words) => format!("each {}", quoted(words)),
            Kind::Toggle => "true, false".to_owned(),
            Kind::Integer(range) | Kind::Number(range) => bare(range).to_string(),
            Kind::IntegerList(range) | Kind::Integers(_, range) | Kind::Numbers(_, range) => {
                format!("each {}", bare(range))
            }
        }
    }

    /// What the value must be, in words: "a whole number", "a list of 3 numbers".
    pub(super) fn kind_text(&self) -> String {
        match self.kind {
            Kind::Text(_) | Kind::Choice(_) => "text in quotes".to_owned(),
            Kind::Choices(_) => "a list of words in quotes".to_owned(),
            Kind::Toggle => "true or false".to_owned(),
            Kind::Integer(_) => "a whole number".to_owned(),
            Kind::Number(_) => "a number".to_owned(),
            Kind::IntegerList(_) => "a list of one or more whole numbers".to_owned(),
            Kind::Integers(count, _) => format!("a list of {count} whole numbers"),
            Kind::Numbers(count, _) => format!("a list of {count} numbers"),
        }
    }

    /// The allowed values with their unit, for the help of an error.
    pub(super) fn allowed_text(&self) -> String {
        match self.unit() {
            "" => format!("allowed: {}", self.range_text()),
            unit => format!("allowed: {} {unit}", self.range_text()),
        }
    }
}

fn quoted(words: &[&str]) -> String {
    let quoted: Vec<String> = words.iter().map(|word| format!("\"{word}\"")).collect();
    quoted.join(", ")
}

/// The keys of a recipe, in the order of its documentation.
pub const RECIPE_KEYS: &[Key] = &[
    required("name", NAME),
    default("description", Kind::Text("any text"), "\"\""),
    required("blade.cad", Kind::Text("builtin:NAME or a path relative to the recipe")),
    default("views.step_deg", number(0.5, 180.0, "deg"), "10.0"),
    default("views.tilt_max_deg", number(0.0, 45.0, "deg"), "0.0"),
    optional("views.skip", integer_list(0.0, 719.0, ""), "none"),
    optional(
        "views.views_min",
        integer(1.0, 720.0, ""),
        "one less than the views that are taken",
    ),
    required("presentation.position_mm", numbers(3, -5000.0, 5000.0, "mm")),
    required("presentation.rotation_deg", numbers(3, -180.0, 180.0, "deg")),
    default("camera.optics", Kind::Choice(&["fine", "medium", "wide"]), "\"medium\""),
    default("camera.binning", Kind::Toggle, "false"),
    optional("camera.roi_px", integers(4, 0.0, 1440.0, "px"), "the whole sensor"),
    default("camera.exposure_us", integer(10.0, 50_000.0, "us"), "1000"),
    optional("camera.hdr_low_us", integer(10.0, 50_000.0, "us"), "off"),
    optional("camera.hdr_high_us", integer(10.0, 50_000.0, "us"), "off"),
    default("camera.image_count", integer(12.0, 60.0, ""), "24"),
    default("camera.led_percent", integer(1.0, 100.0, "%"), "25"),
    default(
        "camera.compression",
        Kind::Choice(&["none", "low", "medium", "high"]),
        "\"low\"",
    ),
    default("camera.frame_time_ratio", number(1.0, 4.0, ""), "1.0"),
    default("camera.score_threshold", number(0.0, 1.0, ""), "0.85"),
    default(
        "camera.outlier_filter",
        Kind::Choice(&["disabled", "permissive", "balanced", "strict"]),
        "\"permissive\"",
    ),
    default("camera.reconstruction_quality", integer(0.0, 9.0, ""), "5"),
    default("camera.pre_filtering", integer(0.0, 9.0, ""), "3"),
    default(
        "camera.working_volume",
        Kind::Choice(&["standard", "extended"]),
        "\"standard\"",
    ),
    default("camera.points_min", integer(1.0, 1_555_200.0, ""), "5000"),
    default("camera.warm_up", Kind::Choice(&["note", "wait", "refuse"]), "\"note\""),
    required("camera.exposure[].views", integer_list(0.0, 719.0, "")),
    required("camera.exposure[].exposure_us", integer(10.0, 50_000.0, "us")),
    optional("camera.exposure[].hdr_low_us", integer(10.0, 50_000.0, "us"), "off"),
    optional("camera.exposure[].hdr_high_us", integer(10.0, 50_000.0, "us"), "off"),
    default("cleaning.outlier_sigma", number(3.0, 100.0, ""), "5.0"),
    default("cleaning.patch_max_px", integer(0.0, 10_000.0, "px"), "400"),
    default("cleaning.incidence_max_deg", number(30.0, 90.0, "deg"), "75.0"),
    default("registration.start", Kind::Choice(&["robot", "previous"]), "\"robot\""),
    default("registration.sample_count", integer(50.0, 20_000.0, ""), "500"),
    optional(
        "registration.overlap_distance_mm",
        number(0.001, 10.0, "mm"),
        "from the optics",
    ),
    default("registration.prior_rotation_max_deg", number(0.01, 45.0, "deg"), "2.0"),
    default(
        "registration.prior_translation_max_mm",
        number(0.01, 100.0, "mm"),
        "5.0",
    ),
    optional(
        "merge.overlap_min_fraction",
        number(0.01, 1.0, ""),
        "required unless overlap_min_count is given",
    ),
    optional(
        "merge.overlap_min_count",
        integer(1.0, 1_555_200.0, ""),
        "required unless overlap_min_fraction is given",
    ),
    optional(
        "merge.coincident_distance_mm",
        number(0.001, 10.0, "mm"),
        "a third of the overlap distance",
    ),
    default("run.retakes_max", integer(0.0, 10.0, ""), "1"),
    default(
        "run.retake_on",
        Kind::Choices(&[
            "no-frame",
            "few-points",
            "saturated",
            "disagrees",
            "ambiguous",
            "little-overlap",
        ]),
        "[\"no-frame\", \"few-points\"]",
    ),
    default("run.retake_exposure_factor", number(1.0, 10.0, ""), "1.0"),
    default("run.saturated_max_fraction", number(0.0, 1.0, ""), "0.2"),
    default("run.check_rotation_max_deg", number(0.01, 45.0, "deg"), "0.5"),
    default("run.check_translation_max_mm", number(0.01, 100.0, "mm"), "2.0"),
];

/// The keys of a station, in the order of its documentation.
pub const STATION_KEYS: &[Key] = &[
    required("name", NAME),
    required("kind", Kind::Choice(&["simulated", "cell"])),
    default(
        "robot.link",
        Kind::Choice(&["hses", "host-control", "serial"]),
        "\"hses\"",
    ),
    optional(
        "robot.address",
        ADDRESS,
        "required, except with a serial link, and for the simulated station that a dry run starts (then leave out both)",
    ),
    optional(
        "robot.serial_device",
        Kind::Text("the path of a serial port"),
        "required with a serial link, except for the simulated station",
    ),
    default("robot.serial_baud", integer(150.0, 115_200.0, "Bd"), "9600"),
    default("robot.motion", Kind::Choice(&["direct", "job"]), "\"direct\""),
    default(
        "robot.job.name",
        Kind::Text("1 to 32 letters, digits, hyphens and underscores"),
        "\"BLADESCAN\"",
    ),
    default("robot.job.position_first", integer(0.0, 999.0, ""), "0"),
    default("robot.job.position_last", integer(0.0, 999.0, ""), "127"),
    default("robot.job.variable_first", integer(0.0, 999.0, ""), "10"),
    default("robot.job.patience_ms", integer(1000.0, 600_000.0, "ms"), "5000"),
    default("robot.tool", integer(0.0, 63.0, ""), "0"),
    default("robot.speed_mm_s", number(0.1, 1500.0, "mm/s"), "50.0"),
    default("robot.rotation_speed_deg_s", number(0.1, 180.0, "deg/s"), "10.0"),
    default("robot.answer_timeout_ms", integer(1.0, 10_000.0, "ms"), "300"),
    default("robot.ask_attempts", integer(1.0, 20.0, ""), "5"),
    default("robot.poll_interval_ms", integer(1.0, 1000.0, "ms"), "20"),
    default("robot.start_grace_ms", integer(0.0, 10_000.0, "ms"), "500"),
    default("robot.move_timeout_ms", integer(100.0, 3_600_000.0, "ms"), "120000"),
    default("robot.settle_ms", integer(0.0, 10_000.0, "ms"), "20"),
    default("robot.servo_timeout_ms", integer(100.0, 60_000.0, "ms"), "5000"),
    default("robot.hold_repeat_ms", integer(1.0, 10_000.0, "ms"), "100"),
    default("robot.hold_timeout_ms", integer(100.0, 60_000.0, "ms"), "5000"),
    default("robot.position_tolerance_mm", number(0.001, 10.0, "mm"), "0.05"),
    default("robot.rotation_tolerance_deg", number(0.0001, 5.0, "deg"), "0.01"),
    default("robot.step_angle_max_deg", number(0.1, 180.0, "deg"), "180.0"),
    required("robot.workspace.min_mm", numbers(3, -10_000.0, 10_000.0, "mm")),
    required("robot.workspace.max_mm", numbers(3, -10_000.0, 10_000.0, "mm")),
    optional(
        "camera.address",
        ADDRESS,
        "required, except for the simulated station that a dry run starts (then leave out both)",
    ),
    default("camera.connect_timeout_ms", integer(1.0, 60_000.0, "ms"), "3000"),
    default("camera.reply_timeout_ms", integer(1.0, 60_000.0, "ms"), "5000"),
    default("camera.frame_timeout_extra_ms", integer(0.0, 600_000.0, "ms"), "2000"),
    default("camera.ping_interval_ms", integer(1.0, 60_000.0, "ms"), "1000"),
    default("camera.dead_after_ms", integer(1.0, 600_000.0, "ms"), "5000"),
    default("camera.reconnect_timeout_ms", integer(0.0, 3_600_000.0, "ms"), "60000"),
    default("camera.device_timeout_ms", integer(0.0, 3_600_000.0, "ms"), "60000"),
    required("calibration.id", Kind::Text("any text that is not empty")),
    required(
        "calibration.base_from_camera.position_mm",
        numbers(3, -10_000.0, 10_000.0, "mm"),
    ),
    required(
        "calibration.base_from_camera.rotation_deg",
        numbers(3, -180.0, 180.0, "deg"),
    ),
    required(
        "calibration.tool_from_blade.position_mm",
        numbers(3, -5000.0, 5000.0, "mm"),
    ),
    required(
        "calibration.tool_from_blade.rotation_deg",
        numbers(3, -180.0, 180.0, "deg"),
    ),
];

const NAME: Kind = Kind::Text("1 to 64 letters, digits, dots, hyphens and underscores");
const ADDRESS: Kind = Kind::Text("HOST:PORT");

const fn required(path: &'static str, kind: Kind) -> Key {
    let need = Need::Required;
    Key { path, kind, need }
}

const fn default(path: &'static str, kind: Kind, toml: &'static str) -> Key {
    let need = Need::Default(toml);
    Key { path, kind, need }
}

const fn optional(path: &'static str, kind: Kind, without: &'static str) -> Key {
    let need = Need::Optional(without);
    Key { path, kind, need }
}

const fn integer(min: f64, max: f64, unit: &'static str) -> Kind {
    Kind::Integer(Range { min, max, unit })
}

const fn number(min: f64, max: f64, unit: &'static str) -> Kind {
    Kind::Number(Range { min, max, unit })
}

const fn integer_list(min: f64, max: f64, unit: &'static str) -> Kind {
    Kind::IntegerList(Range { min, max, unit })
}

const fn integers(count: usize, min: f64, max: f64, unit: &'static str) -> Kind {
    Kind::Integers(count, Range { min, max, unit })
}

const fn numbers(count: usize, min: f64, max: f64, unit: &'static str) -> Kind {
    Kind::Numbers(count, Range { min, max, unit })
}
