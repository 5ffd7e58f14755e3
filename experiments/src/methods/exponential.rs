//! The exponential function, many at a time: it is inlined into work that runs in vector units.

/// e to the power of `x`, which is at most 0: relative error below 1e-11, and 1e-304 for all that lies below -700.
#[inline(always)]
pub(crate) fn exp(x: f64) -> f64 {
    let powers = (x.max(EXPONENT_MIN) * std::f64::consts::LOG2_E) + ROUNDING;
    let rest = x.max(EXPONENT_MIN) - (powers - ROUNDING) * std::f64::consts::LN_2;
    let mut series = 0.0;
    for factor in INVERSE_FACTORIALS {
        series = series * rest + factor;
    }
    // The low bits of `powers` are the whole number of powers of two.
    series * f64::from_bits(powers.to_bits().wrapping_add(1023) << 52)
}

/// Below it e^x is as good as nothing.
const EXPONENT_MIN: f64 = -700.0;

/// Added to a small number, leaves its nearest whole number in the lowest bits.
const ROUNDING: f64 = 6_755_399_441_055_744.0;

/// 1/k! from k = 10 down to 0.
const INVERSE_FACTORIALS: [f64; 11] = [
    1.0 / 3_628_800.0,
    1.0 / 362_880.0,
    1.0 / 40_320.0,
    1.0 / 5_040.0,
    1.0 / 720.0,
    1.0 / 120.0,
    1.0 / 24.0,
    1.0 / 6.0,
    0.5,
    1.0,
    1.0,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_that_of_the_library() {
        for step in 0..70_000 {
            let x = -0.01 * f64::from(step);
            assert!((exp(x) / x.exp() - 1.0).abs() < 1e-11, "{x}");
        }
        assert!(exp(f64::NEG_INFINITY) < 1e-300);
    }
}
