//! Of many things those that differ from each other.

/// Appends those of `more`, in order, that are distinct from all that is in `kept` by then, until it has `max_count`.
pub(super) fn add_distinct<T>(
    kept: &mut Vec<T>,
    more: impl IntoIterator<Item = T>,
    max_count: usize,
    distinct: impl Fn(&T, &T) -> bool,
) {
    for one in more {
        if kept.len() >= max_count {
            return;
        }
        if kept.iter().all(|other| distinct(other, &one)) {
            kept.push(one);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_those_alike_is_kept_and_no_more_than_wanted() {
        let mut kept = vec![10];
        add_distinct(&mut kept, [11, 20, 9, 21, 30, 40], 3, |a: &i32, b| a.abs_diff(*b) > 2);
        assert_eq!(kept, [10, 20, 30]);
    }
}
