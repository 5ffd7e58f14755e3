//! Arguments of a command, and numbers as host control writes them.

use crate::robot::refused::{Answer, Refused};

/// Arguments between commas; spaces around them do not count.
pub(super) struct Arguments<'a>(Vec<&'a str>);

impl<'a> Arguments<'a> {
    /// None for an empty text.
    pub(super) fn read(data: &'a str) -> Self {
        Self(match data.trim() {
            "" => Vec::new(),
            data => data.split(',').map(str::trim).collect(),
        })
    }

    /// All of them, if there are so many; 1011 otherwise.
    pub(super) fn exactly<const COUNT: usize>(&self) -> Answer<[&'a str; COUNT]> {
        self.0.as_slice().try_into().map_err(|_| Refused::OPERAND_COUNT)
    }

    /// The first ones and the rest; 1011 for fewer.
    pub(super) fn at_least<const COUNT: usize>(&self) -> Answer<([&'a str; COUNT], &[&'a str])> {
        let (first, rest) = self.0.split_first_chunk::<COUNT>().ok_or(Refused::OPERAND_COUNT)?;
        Ok((*first, rest))
    }

    /// 1011 for any argument.
    pub(super) fn none(&self) -> Answer<()> {
        self.exactly::<0>().map(|_| ())
    }

    /// The only argument, if there is one; 1011 for more.
    pub(super) fn at_most_one(&self) -> Answer<Option<&'a str>> {
        match self.0[..] {
            [] => Ok(None),
            [one] => Ok(Some(one)),
            _ => Err(Refused::OPERAND_COUNT),
        }
    }

    /// One flag, 0 or 1.
    pub(super) fn flag(&self) -> Answer<bool> {
        let [flag] = self.exactly()?;
        match flag {
            "0" => Ok(false),
            "1" => Ok(true),
            _ => Err(Refused::OPERAND_RANGE),
        }
    }
}

/// A whole number; 1012 otherwise.
pub(super) fn integer<T: std::str::FromStr>(text: &str) -> Answer<T> {
    text.parse().map_err(|_| Refused::OPERAND_RANGE)
}

/// Whole numbers, so many of them.
pub(super) fn integers<const COUNT: usize>(texts: &[&str]) -> Answer<[i32; COUNT]> {
    let numbers: Vec<i32> = texts.iter().map(|text| integer(text)).collect::<Answer<_>>()?;
    numbers.try_into().map_err(|_| Refused::OPERAND_COUNT)
}

/// A decimal number in units of its `digits`-th decimal, rounded; 1012 for none, or for one too large.
pub(super) fn decimal(text: &str, digits: i32) -> Answer<i32> {
    let is_plain = text
        .bytes()
        .all(|byte| matches!(byte, b'0'..=b'9' | b'.' | b'-' | b'+'));
    let number: f64 = text.parse().map_err(|_| Refused::OPERAND_RANGE)?;
    let scaled = (number * 10_f64.powi(digits)).round();
    if is_plain && scaled.abs() <= f64::from(i32::MAX) {
        Ok(scaled as i32)
    } else {
        Err(Refused::OPERAND_RANGE)
    }
}

/// A number in units of its `digits`-th decimal, with all of these decimals.
pub(super) fn written(number: i32, digits: usize) -> String {
    let unit = 10_u32.pow(digits as u32);
    let (sign, size) = (if number < 0 { "-" } else { "" }, number.unsigned_abs());
    format!("{sign}{}.{:0digits$}", size / unit, size % unit)
}

/// Numbers with commas between them.
pub(super) fn list<T: ToString>(numbers: impl IntoIterator<Item = T>) -> String {
    let texts: Vec<String> = numbers.into_iter().map(|number| number.to_string()).collect();
    texts.join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_are_written_with_all_their_digits_and_read_back() {
        for (number, digits, text) in [
            (353_769, 3, "353.769"),
            (-13_400, 4, "-1.3400"),
            (-5, 3, "-0.005"),
            (0, 4, "0.0000"),
            (i32::MIN + 1, 3, "-2147483.647"),
        ] {
            assert_eq!(written(number, digits as usize), text);
            assert_eq!(decimal(text, digits), Ok(number));
        }
        assert_eq!(decimal("100", 3), Ok(100_000));
        assert_eq!(decimal("-90.00", 4), Ok(-900_000));
    }

    #[test]
    fn what_is_no_plain_decimal_is_out_of_range() {
        for text in ["", "1e3", "inf", "NaN", "1,5", "--1", "9999999", "0x10"] {
            assert_eq!(decimal(text, 3), Err(Refused::OPERAND_RANGE), "{text:?}");
        }
    }

    #[test]
    fn spaces_after_commas_do_not_count_and_the_count_does() {
        assert_eq!(Arguments::read("0, 0").exactly(), Ok(["0", "0"]));
        assert_eq!(Arguments::read(" ").none(), Ok(()));
        assert_eq!(Arguments::read("1,2").flag(), Err(Refused::OPERAND_COUNT));
        assert_eq!(Arguments::read("2").flag(), Err(Refused::OPERAND_RANGE));
    }
}
