//! Exposures of single views in a recipe.

use crate::settings::{RECIPE, recipe_error};
use bladescan::settings::Recipe;

#[test]
fn views_have_exposures_of_their_own() {
    let tables = "[[camera.exposure]]\nviews = [0, 18]\nexposure_us = 400\nhdr_high_us = 4000\n\
                  [[camera.exposure]]\nviews = [9]\nexposure_us = 2000\n[merge]";
    let text = RECIPE.replace("[merge]", tables);
    let recipe = Recipe::parse("probe.toml", &text).unwrap();
    let of = |view_index| {
        let exposure = recipe.camera.exposure_of(view_index);
        (exposure.exposure_us, exposure.hdr_low_us, exposure.hdr_high_us)
    };
    assert_eq!(of(18), (400, None, Some(4000)));
    assert_eq!(of(9), (2000, None, None));
    assert_eq!(of(1), (1000, None, None));
}

#[test]
fn a_mistake_in_a_table_of_exposures_is_shown_where_it_stands() {
    let error = |table: &str| recipe_error("[merge]", &format!("{table}\n[merge]"));
    let message = |table: &str| error(table).message().to_owned();
    let twice =
        "[[camera.exposure]]\nviews = [3]\nexposure_us = 400\n[[camera.exposure]]\nviews = [4, 3]\nexposure_us = 500";
    assert_eq!(message(twice), "`camera.exposure[].views` names view 3 a second time");
    let beyond = error("[[camera.exposure]]\nviews = [3, 36]\nexposure_us = 400");
    assert_eq!(
        beyond.message(),
        "`camera.exposure[].views` names view 36, but there are 36 views, from 0"
    );
    let missing = error("[[camera.exposure]]\nviews = [3]");
    assert_eq!(
        missing.message(),
        "`camera.exposure[].exposure_us` is missing: it must be a whole number"
    );
    let range = message("[[camera.exposure]]\nviews = [3]\nexposure_us = 5");
    assert_eq!(
        range,
        "`camera.exposure[].exposure_us` is 5 us, allowed is 10 to 50000 us"
    );
    let empty = message("[[camera.exposure]]\nviews = []\nexposure_us = 50");
    assert_eq!(
        empty,
        "`camera.exposure[].views` must be a list of one or more whole numbers, not 0"
    );
    let single = message("[camera.exposure]\nviews = [3]\nexposure_us = 50");
    assert_eq!(
        single,
        "`camera.exposure` may stand several times: write [[camera.exposure]]"
    );
    let unknown = error("[[camera.exposure]]\nviews = [3]\nexposure = 50");
    assert_eq!(
        (unknown.message(), unknown.help_text()),
        (
            "unknown key `camera.exposure[].exposure`",
            Some("keys of [[camera.exposure]]: views, exposure_us, hdr_low_us, hdr_high_us")
        )
    );
}
