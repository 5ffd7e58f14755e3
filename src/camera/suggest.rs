//! Which exposures suit a part that stands before the camera, from frames taken of it at several exposures.
//!
//! No model of light is needed: the part stands still, so a pixel that has 3D in one of the frames, or is too bright even in
//! the darkest, lies on the part, and which exposure serves which pixels is counted.

use serde::Serialize;

/// One frame of the series.
#[derive(Debug, Clone, Copy)]
pub struct Exposed<'a> {
    /// Its exposure, µs.
    pub exposure_us: u32,
    /// Its MASK, one byte per pixel; every frame of the series has the same size.
    pub mask: &'a [u8],
}

/// What one exposure gives, as shares of the pixels on the part.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Served {
    /// The exposure, µs.
    pub exposure_us: u32,
    /// With 3D.
    pub valid_fraction: f64,
    /// Too bright.
    pub saturated_fraction: f64,
    /// Without 3D, modulation too low, and not too bright: too dark.
    pub dark_fraction: f64,
    /// Without 3D for other reasons: seen too obliquely, in a shadow, filtered, or by chance.
    pub other_fraction: f64,
}

/// The exposures that suit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Suggestion {
    /// For `camera.exposure_us`.
    pub exposure_us: u32,
    /// For `camera.hdr_low_us`: serves what is too bright at `exposure_us`.
    pub hdr_low_us: Option<u32>,
    /// For `camera.hdr_high_us`: serves what is too dark at `exposure_us`.
    pub hdr_high_us: Option<u32>,
    /// Pixels on the part.
    pub part_count: usize,
    /// Share of them with 3D in at least one of the suggested passes.
    pub valid_fraction: f64,
    /// Share of them that no frame of the series served.
    pub never_fraction: f64,
    /// What each exposure of the series gives, ascending.
    pub served: Vec<Served>,
}

/// Chooses from a series of at least one frame; `None` when no frame has a pixel with 3D.
///
/// The main exposure is the longest of those whose pixels with 3D are within [`PASS_FRACTION`] of the part of the most:
/// brighter images have less noise. A darker pass is added when more than [`PASS_FRACTION`] of the part gains 3D by it among the
/// pixels too bright in the main one, a brighter pass likewise among the too dark ones: of several the one that gains most, of
/// equal ones that nearest to the main exposure.
pub fn suggest(series: &[Exposed<'_>]) -> Option<Suggestion> {
    let mut series = series.to_vec();
    series.sort_by_key(|frame| frame.exposure_us);
    let pixel_count = series.iter().map(|frame| frame.mask.len()).min()?;
    let on_part: Vec<usize> = (0..pixel_count)
        .filter(|&pixel| {
            series
                .iter()
                .any(|frame| is_valid(frame, pixel) || is_saturated(frame, pixel))
        })
        .collect();
    let count = |fits: &dyn Fn(usize) -> bool| on_part.iter().filter(|pixel| fits(**pixel)).count();
    let share = |number: usize| number as f64 / on_part.len() as f64;
    let served: Vec<Served> = series
        .iter()
        .map(|frame| Served {
            exposure_us: frame.exposure_us,
            valid_fraction: share(count(&|pixel| is_valid(frame, pixel))),
            saturated_fraction: share(count(&|pixel| is_saturated(frame, pixel))),
            dark_fraction: share(count(&|pixel| is_dark(frame, pixel))),
            other_fraction: share(count(&|pixel| {
                !is_valid(frame, pixel) && !is_saturated(frame, pixel) && !is_dark(frame, pixel)
            })),
        })
        .collect();
    let valid_counts: Vec<usize> = series
        .iter()
        .map(|frame| count(&|pixel| is_valid(frame, pixel)))
        .collect();
    let most = valid_counts.iter().copied().max().filter(|most| *most > 0)?;
    let main = valid_counts
        .iter()
        .rposition(|valid| share(most - valid) <= PASS_FRACTION)?;
    let gains = |from: std::ops::Range<usize>, bright: bool| -> Vec<usize> {
        let lacks = |pixel| match bright {
            true => !is_valid(&series[main], pixel) && is_saturated(&series[main], pixel),
            false => is_dark(&series[main], pixel),
        };
        from.map(|other| count(&|pixel| lacks(pixel) && is_valid(&series[other], pixel)))
            .collect()
    };
    let worth = |gained: usize| share(gained) > PASS_FRACTION;
    let mut darker = gains(0..main, true);
    darker.reverse();
    let low = first_greatest(&darker)
        .filter(|place| worth(darker[*place]))
        .map(|place| main - 1 - place);
    let brighter = gains(main + 1..series.len(), false);
    let high = first_greatest(&brighter)
        .filter(|place| worth(brighter[*place]))
        .map(|place| main + 1 + place);
    let passes: Vec<usize> = [Some(main), low, high].into_iter().flatten().collect();
    let served_by = |pixel: usize, frames: &[usize]| frames.iter().any(|frame| is_valid(&series[*frame], pixel));
    let all: Vec<usize> = (0..series.len()).collect();
    Some(Suggestion {
        exposure_us: series[main].exposure_us,
        hdr_low_us: low.map(|frame| series[frame].exposure_us),
        hdr_high_us: high.map(|frame| series[frame].exposure_us),
        part_count: on_part.len(),
        valid_fraction: share(count(&|pixel| served_by(pixel, &passes))),
        never_fraction: share(count(&|pixel| !served_by(pixel, &all))),
        served,
    })
}

/// Exposures of a series: even steps of the logarithm about the usual one, within the camera's range, ascending.
pub fn series_us(usual_us: u32, range_us: [u32; 2], frame_count: usize) -> Vec<u32> {
    let middle = (frame_count as f64 - 1.0) / 2.0;
    let exposure = |frame: usize| f64::from(usual_us) * SERIES_RATIO.powf(frame as f64 - middle);
    let within = |exposure: f64| (exposure.round() as u32).clamp(range_us[0], range_us[1]);
    let mut exposures_us: Vec<u32> = (0..frame_count).map(|frame| within(exposure(frame))).collect();
    exposures_us.dedup();
    exposures_us
}

fn is_valid(frame: &Exposed<'_>, pixel: usize) -> bool {
    frame.mask[pixel] & 1 == 0
}

fn is_saturated(frame: &Exposed<'_>, pixel: usize) -> bool {
    frame.mask[pixel] & 2 != 0
}

fn is_dark(frame: &Exposed<'_>, pixel: usize) -> bool {
    !is_valid(frame, pixel) && !is_saturated(frame, pixel) && frame.mask[pixel] & 4 != 0
}

fn first_greatest(counts: &[usize]) -> Option<usize> {
    let greatest = counts.iter().max()?;
    counts.iter().position(|count| count == greatest)
}

/// A pass that serves no more of the part than this is not worth its time.
pub const PASS_FRACTION: f64 = 0.01;
/// From one exposure of a series to the next.
const SERIES_RATIO: f64 = 2.5;

#[cfg(test)]
mod tests {
    use super::*;

    const VALID: u8 = 0;
    const BRIGHT: u8 = 0b11;
    const DARK: u8 = 0b101;
    const NOWHERE: u8 = 1;

    /// 100 pixels: `bright`, then `dark`, then usual ones, then 20 beside the part.
    fn frame(exposure_us: u32, bright: [u8; 2], dark: [u8; 2], usual: u8) -> (u32, Vec<u8>) {
        let mask = [
            vec![bright[0]; 10],
            vec![bright[1]; 5],
            vec![dark[0]; 6],
            vec![dark[1]; 4],
            vec![usual; 55],
            vec![NOWHERE; 20],
        ];
        (exposure_us, mask.concat())
    }

    fn choose(series: &[(u32, Vec<u8>)]) -> Option<Suggestion> {
        let series: Vec<Exposed<'_>> = series
            .iter()
            .map(|(exposure_us, mask)| Exposed {
                exposure_us: *exposure_us,
                mask,
            })
            .collect();
        suggest(&series)
    }

    #[test]
    fn a_matte_part_needs_one_pass() {
        let all = |exposure_us, state| frame(exposure_us, [state; 2], [state; 2], state);
        let suggestion = choose(&[all(400, DARK), all(1000, VALID), all(2500, VALID)]).unwrap();
        assert_eq!(suggestion.exposure_us, 2500, "the longer of two that serve alike");
        assert_eq!((suggestion.hdr_low_us, suggestion.hdr_high_us), (None, None));
        assert_eq!((suggestion.part_count, suggestion.valid_fraction), (80, 1.0));
    }

    #[test]
    fn a_polished_part_gets_a_darker_and_a_brighter_pass() {
        let series = [
            frame(160, [VALID, VALID], [DARK, DARK], DARK),
            frame(400, [VALID, BRIGHT], [DARK, DARK], DARK),
            frame(1000, [BRIGHT, BRIGHT], [DARK, DARK], VALID),
            frame(2500, [BRIGHT, BRIGHT], [VALID, DARK], VALID),
            frame(6250, [BRIGHT, BRIGHT], [VALID, VALID], BRIGHT),
        ];
        let suggestion = choose(&series).unwrap();
        assert_eq!(suggestion.exposure_us, 2500);
        assert_eq!((suggestion.hdr_low_us, suggestion.hdr_high_us), (Some(160), Some(6250)));
        assert_eq!((suggestion.valid_fraction, suggestion.never_fraction), (1.0, 0.0));
        assert_eq!(suggestion.served[0].saturated_fraction, 0.0);
        assert_eq!(suggestion.served[2].saturated_fraction, 15.0 / 80.0);
        let mut shuffled = series.to_vec();
        shuffled.reverse();
        assert_eq!(
            choose(&shuffled).unwrap(),
            suggestion,
            "the order of taking does not count"
        );
    }

    #[test]
    fn what_no_exposure_serves_is_told() {
        let series = [
            frame(400, [BRIGHT, BRIGHT], [DARK, DARK], VALID),
            frame(1000, [BRIGHT, BRIGHT], [DARK, DARK], VALID),
        ];
        let suggestion = choose(&series).unwrap();
        assert_eq!(
            suggestion.never_fraction,
            15.0 / 70.0,
            "dark pixels that never have 3D are not known to lie on the part"
        );
        assert_eq!(suggestion.hdr_low_us, None);
    }

    #[test]
    fn what_is_lost_by_chance_asks_for_no_pass() {
        let lost = |from: usize| {
            let mut mask = vec![VALID; 100];
            mask[from..from + 5].fill(NOWHERE);
            mask
        };
        let suggestion = choose(&[(400, lost(0)), (1000, lost(20)), (2500, lost(40))]).unwrap();
        assert_eq!((suggestion.hdr_low_us, suggestion.hdr_high_us), (None, None));
        assert_eq!(suggestion.served[0].other_fraction, 0.05);
    }

    #[test]
    fn nothing_seen_gives_no_suggestion() {
        assert_eq!(choose(&[frame(1000, [NOWHERE; 2], [NOWHERE; 2], NOWHERE)]), None);
        assert_eq!(suggest(&[]), None);
    }

    #[test]
    fn a_series_lies_about_the_usual_exposure_and_within_the_range() {
        assert_eq!(series_us(1000, [10, 50_000], 5), [160, 400, 1000, 2500, 6250]);
        assert_eq!(series_us(1000, [500, 2000], 5), [500, 1000, 2000]);
        assert_eq!(series_us(1000, [10, 50_000], 1), [1000]);
    }
}
