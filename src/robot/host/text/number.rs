//! Numbers with a fixed count of decimals, as whole multiples of their last digit.

/// `value` units of the last decimal, written out: (-12345, 3) is "-12.345".
pub(super) fn write_fixed(value: i32, decimals: u32) -> String {
    let magnitude = i64::from(value).unsigned_abs();
    let unit = 10u64.pow(decimals);
    let sign = if value < 0 { "-" } else { "" };
    let width = decimals as usize;
    format!("{sign}{}.{:0width$}", magnitude / unit, magnitude % unit)
}

/// Reads a decimal number as units of its `decimals`-th decimal; fewer decimals are filled up, more are rounded half away
/// from zero. `None` when it is no such number or does not fit.
pub(super) fn read_fixed(text: &str, decimals: u32) -> Option<i32> {
    let (negative, digits) = match text.as_bytes() {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        rest => (false, rest),
    };
    let (whole, fraction) = match digits.iter().position(|&byte| byte == b'.') {
        Some(at) => (&digits[..at], &digits[at + 1..]),
        None => (digits, &[][..]),
    };
    if whole.is_empty() && fraction.is_empty() || whole.len() > DIGITS_MAX || fraction.len() > DIGITS_MAX {
        return None;
    }
    let mut value = 0i64;
    let filled = fraction.iter().copied().chain(std::iter::repeat(b'0'));
    for digit in whole.iter().copied().chain(filled.take(decimals as usize)) {
        value = value.checked_mul(10)?.checked_add(i64::from(digit_of(digit)?))?;
    }
    let rest = fraction.get(decimals as usize..).unwrap_or_default();
    if !rest.iter().all(u8::is_ascii_digit) {
        return None;
    }
    if rest.first().is_some_and(|&digit| digit >= b'5') {
        value += 1;
    }
    i32::try_from(if negative { -value } else { value }).ok()
}

fn digit_of(byte: u8) -> Option<u8> {
    byte.is_ascii_digit().then(|| byte - b'0')
}

/// More digits before or behind the point are no number of this protocol.
const DIGITS_MAX: usize = 12;
