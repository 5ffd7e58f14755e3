//! Lists of reasons to refuse, in the order in which they are looked at.

/// Refuses with the first reason that holds.
pub(crate) fn refuse_first<E>(reasons: impl IntoIterator<Item = (bool, E)>) -> Result<(), E> {
    match reasons.into_iter().find(|(holds, _)| *holds) {
        Some((_, reason)) => Err(reason),
        None => Ok(()),
    }
}
