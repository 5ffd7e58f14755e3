//! `bladescan camera settings`.

use super::super::{Exit, Failure, print};
use super::{Place, Source, row};
use crate::camera::{
    CameraSettings, Caps, Configured, Exposed, PASS_FRACTION, Suggestion, TriggerId, Visit, difference, series_us,
    suggest,
};
use serde_json::json;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    place: Place,
    #[command(flatten)]
    source: Source,
    /// Take frames at several exposures and suggest those that suit the part that stands before the camera.
    #[arg(long)]
    suggest: bool,
    /// How many frames.
    #[arg(long, value_name = "N", default_value_t = 7, requires = "suggest", value_parser = clap::value_parser!(u8).range(1..=15))]
    frames: u8,
}

pub(super) fn main(args: &Args, json: bool) -> Result<Exit, Failure> {
    let recipe = args.source.read()?;
    let mut visit = args.place.control()?;
    let caps = visit.caps()?;
    let settings = args.source.settings(recipe.as_ref(), &caps);
    let optics = recipe.map(|recipe| recipe.camera.optics.name());
    if let Some(optics) = optics.filter(|optics| *optics != caps.optics) {
        return Err(Failure::Broken(format!(
            "the recipe wants optics {optics}, the camera has {}",
            caps.optics
        )));
    }
    if args.suggest {
        let suggestion = series(&mut visit, &caps, &settings, usize::from(args.frames));
        visit.leave();
        return tell_suggestion(suggestion?.as_ref(), json);
    }
    let configured = visit.configure(&settings)?;
    visit.leave();
    let odd = difference(&settings, &configured.settings);
    if json {
        let document = json!({
            "asked": settings,
            "in_force": configured.settings,
            "difference": odd,
            "config_id": configured.config_id,
            "predicted_exposure_us": configured.predicted_exposure_us,
            "predicted_total_us": configured.predicted_total_us,
            "frame_bytes": configured.frame_bytes,
        });
        print(&document.to_string())?;
    } else {
        print(&as_table(&configured))?;
        print(&row(
            "echo",
            odd.as_deref().unwrap_or("every value is in force as asked"),
        ))?;
    }
    Ok(if odd.is_none() { Exit::Done } else { Exit::Fault })
}

fn as_table(configured: &Configured) -> String {
    let settings = &configured.settings;
    let [width, height, x_1, y_1, x_2, y_2] = settings.roi_px;
    let region = match settings.binning {
        true => "the whole sensor, binned 2 x 2".to_owned(),
        false => format!("{width} x {height} px at {x_1}, {y_1} (camera 1) and {x_2}, {y_2} (camera 2)"),
    };
    let pass = |exposure_us: u32| match exposure_us {
        0 => "off".to_owned(),
        _ => format!("{exposure_us} us"),
    };
    [
        row("region", region),
        row(
            "exposure",
            format!("{} us, {} images", settings.exposure_us, settings.image_count),
        ),
        row(
            "HDR",
            format!("low {}, high {}", pass(settings.hdr_us[0]), pass(settings.hdr_us[1])),
        ),
        row(
            "LED",
            format!(
                "{} %, frame time {} x exposure",
                settings.led_percent, settings.frame_time_ratio
            ),
        ),
        row(
            "quality",
            format!(
                "compression {}, score from {}, outlier filter {}, reconstruction {}, pre-filtering {}, volume {}",
                settings.compression,
                settings.score_threshold,
                settings.outlier_filter,
                settings.reconstruction_quality,
                settings.pre_filtering,
                settings.working_volume
            ),
        ),
        row(
            "predicted",
            format!(
                "exposure {:.1} ms, frame after {:.1} ms, {:.2} MB",
                f64::from(configured.predicted_exposure_us) * 1e-3,
                f64::from(configured.predicted_total_us) * 1e-3,
                configured.frame_bytes as f64 * 1e-6
            ),
        ),
    ]
    .join("\n")
}

/// Frames at several exposures, without HDR, and what suits.
fn series(
    visit: &mut Visit<'_>,
    caps: &Caps,
    settings: &CameraSettings,
    frame_count: usize,
) -> Result<Option<Suggestion>, Failure> {
    let range_us = [caps.exposure_min_us, caps.exposure_max_us];
    let mut frames = Vec::new();
    for (attempt, exposure_us) in series_us(settings.exposure_us, range_us, frame_count)
        .into_iter()
        .enumerate()
    {
        let configured = visit.configure(&CameraSettings {
            exposure_us,
            hdr_us: [0; 2],
            ..*settings
        })?;
        let capture = visit.capture(&configured, TriggerId::new(0, attempt as u16))?;
        frames.push((exposure_us, capture.mask));
    }
    let exposed: Vec<Exposed<'_>> = frames
        .iter()
        .map(|(exposure_us, mask)| Exposed {
            exposure_us: *exposure_us,
            mask,
        })
        .collect();
    Ok(suggest(&exposed))
}

fn tell_suggestion(suggestion: Option<&Suggestion>, json: bool) -> Result<Exit, Failure> {
    if json {
        print(&json!(suggestion).to_string())?;
        return Ok(if suggestion.is_some() { Exit::Done } else { Exit::Short });
    }
    let Some(suggestion) = suggestion else {
        print("no frame has a pixel with 3D: is there a part within the working distance?")?;
        return Ok(Exit::Short);
    };
    let percent = |fraction: f64| format!("{:5.1} %", 100.0 * fraction);
    let mut lines = vec![
        format!("# {} pixels lie on the part", suggestion.part_count),
        "# exposure     with 3D  too bright   too dark  otherwise without".to_owned(),
    ];
    for served in &suggestion.served {
        lines.push(format!(
            "# {:6} us    {}     {}    {}   {}",
            served.exposure_us,
            percent(served.valid_fraction),
            percent(served.saturated_fraction),
            percent(served.dark_fraction),
            percent(served.other_fraction)
        ));
    }
    lines.push("[camera]".into());
    lines.push(format!(
        "exposure_us = {}    # the longest with the most pixels with 3D, or 1 % of the part fewer",
        suggestion.exposure_us
    ));
    let least = percent(PASS_FRACTION).trim().to_owned();
    lines.push(match suggestion.hdr_low_us {
        Some(low_us) => format!(
            "hdr_low_us = {low_us}    # for what is too bright at {} us",
            suggestion.exposure_us
        ),
        None => format!("# no hdr_low_us: a darker pass would serve no more than {least} of the part"),
    });
    lines.push(match suggestion.hdr_high_us {
        Some(high_us) => format!(
            "hdr_high_us = {high_us}    # for what is too dark at {} us",
            suggestion.exposure_us
        ),
        None => format!("# no hdr_high_us: a brighter pass would serve no more than {least} of the part"),
    });
    lines.push(format!(
        "# together they serve {} of the part",
        percent(suggestion.valid_fraction).trim()
    ));
    if suggestion.never_fraction > PASS_FRACTION {
        lines.push(format!(
            "# {} is served by no exposure of the series: other poses, a lower score_threshold or spray may help",
            percent(suggestion.never_fraction).trim()
        ));
    }
    print(&lines.join("\n"))?;
    Ok(Exit::Done)
}
