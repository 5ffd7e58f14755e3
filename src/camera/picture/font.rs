//! Capitals, digits and signs of 3 x 5 dots.

/// Picture pixels along a dot.
pub(super) const DOT_PX: usize = 2;
/// From one letter to the next.
pub(super) const ADVANCE_PX: usize = 4 * DOT_PX;
/// Height of a letter.
pub(super) const HEIGHT_PX: usize = 5 * DOT_PX;

/// Columns and rows of the dots of a letter; none for a space and for what has no shape.
pub(super) fn dots(letter: char) -> impl Iterator<Item = (usize, usize)> {
    let shape = SHAPES.iter().find(|(known, _)| *known == letter);
    let rows = shape.map_or([0; 5], |(_, rows)| *rows);
    (0..15)
        .map(|dot| (dot % 3, dot / 3))
        .filter(move |(x, y)| rows[*y] >> (2 - x) & 1 == 1)
}

/// Rows from the top; the highest of three bits is the left dot.
const SHAPES: &[(char, [u8; 5])] = &[
    ('0', [7, 5, 5, 5, 7]),
    ('1', [2, 6, 2, 2, 7]),
    ('2', [7, 1, 7, 4, 7]),
    ('3', [7, 1, 3, 1, 7]),
    ('4', [5, 5, 7, 1, 1]),
    ('5', [7, 4, 7, 1, 7]),
    ('6', [7, 4, 7, 5, 7]),
    ('7', [7, 1, 1, 2, 2]),
    ('8', [7, 5, 7, 5, 7]),
    ('9', [7, 5, 7, 1, 7]),
    ('.', [0, 0, 0, 0, 2]),
    ('-', [0, 0, 7, 0, 0]),
    ('A', [2, 5, 7, 5, 5]),
    ('D', [6, 5, 5, 5, 6]),
    ('E', [7, 4, 6, 4, 7]),
    ('H', [5, 5, 7, 5, 5]),
    ('I', [7, 2, 2, 2, 7]),
    ('M', [5, 7, 7, 5, 5]),
    ('N', [6, 5, 5, 5, 5]),
    ('O', [2, 5, 5, 5, 2]),
    ('P', [6, 5, 6, 4, 4]),
    ('R', [6, 5, 6, 5, 5]),
    ('S', [3, 4, 2, 1, 6]),
    ('T', [7, 2, 2, 2, 2]),
    ('U', [5, 5, 5, 5, 7]),
    ('Y', [5, 5, 2, 2, 2]),
];
