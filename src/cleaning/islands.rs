//! Islands: sets of linked pixels, and how large each is.

use std::ops::Range;

use super::steps::{BELOW, Links, MEASURED, RIGHT, TAKEN_OUT};

/// A stretch of linked pixels in one row.
#[derive(Debug, Clone, Copy)]
struct Run {
    row: u32,
    first: u32,
    end: u32,
}

/// Calls `found` with row and columns of every stretch of pixels that belongs to a small island with a cliff about it, row
/// by row: at most `count_max` pixels, and of the sides towards pixels that are no part of it at least
/// [`CLIFF_MIN_FRACTION`] towards a measured one.
pub(super) fn for_small_islands(links: &Links, count_max: usize, mut found: impl FnMut(usize, Range<usize>)) {
    if links.width == 0 {
        return;
    }
    let (runs, mut parents) = joined_runs(links);
    let mut islands = vec![Island::default(); runs.len()];
    for (index, run) in runs.iter().enumerate() {
        let island = &mut islands[root(&mut parents, index as u32) as usize];
        island.count += (run.end - run.first) as usize;
    }
    for (index, run) in runs.iter().enumerate() {
        let island = &mut islands[root(&mut parents, index as u32) as usize];
        if island.count <= count_max {
            island.add_sides(links, run);
        }
    }
    for (index, run) in runs.iter().enumerate() {
        let island = &islands[root(&mut parents, index as u32) as usize];
        if island.count <= count_max && island.cliff_count as f32 >= CLIFF_MIN_FRACTION * island.side_count as f32 {
            found(run.row as usize, run.first as usize..run.end as usize);
        }
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Island {
    /// Pixels.
    count: usize,
    /// Sides of its pixels that lead out of it.
    side_count: usize,
    /// Of these, sides towards a measured point.
    cliff_count: usize,
}

impl Island {
    fn add_sides(&mut self, links: &Links, run: &Run) {
        let row = run.row as usize;
        let bits = |row: usize, column: usize| links.bits[row * links.width + column];
        let mut add = |outside: Option<u8>| {
            self.side_count += 1;
            self.cliff_count += usize::from(outside.is_some_and(|bits| bits & (MEASURED | TAKEN_OUT) != 0));
        };
        add(run.first.checked_sub(1).map(|left| bits(row, left as usize)));
        add(((run.end as usize) < links.width).then(|| bits(row, run.end as usize)));
        for column in run.first as usize..run.end as usize {
            let above = row.checked_sub(1).map(|above| bits(above, column));
            if above.is_none_or(|above| above & BELOW == 0) {
                add(above);
            }
            if bits(row, column) & BELOW == 0 {
                add((row + 1 < links.height).then(|| bits(row + 1, column)));
            }
        }
    }
}

/// All runs, row by row, and a tree over them: runs of one island have one root.
fn joined_runs(links: &Links) -> (Vec<Run>, Vec<u32>) {
    let mut runs: Vec<Run> = Vec::new();
    let mut parents: Vec<u32> = Vec::new();
    // The runs of the row above begin here.
    let mut above = 0;
    for (row, bits) in links.bits.chunks_exact(links.width).enumerate() {
        let begin = runs.len();
        let mut column = 0;
        while column < links.width {
            if bits[column] & MEASURED == 0 {
                column += 1;
                continue;
            }
            let first = column;
            while bits[column] & RIGHT != 0 && column + 1 < links.width {
                column += 1;
            }
            column += 1;
            parents.push(runs.len() as u32);
            runs.push(Run {
                row: row as u32,
                first: first as u32,
                end: column as u32,
            });
        }
        if row > 0 {
            let bits_above = &links.bits[(row - 1) * links.width..][..links.width];
            join(&runs, &mut parents, above..begin, begin, bits_above);
        }
        above = begin;
    }
    (runs, parents)
}

/// Joins the runs of a row, from `begin` on, with those of the row above.
fn join(runs: &[Run], parents: &mut [u32], above: Range<usize>, begin: usize, bits_above: &[u8]) {
    let mut upper = above.start;
    for lower in begin..runs.len() {
        let run = runs[lower];
        while upper < above.end && runs[upper].end <= run.first {
            upper += 1;
        }
        let mut candidate = upper;
        while candidate < above.end && runs[candidate].first < run.end {
            let shared = run.first.max(runs[candidate].first)..run.end.min(runs[candidate].end);
            let shared = &bits_above[shared.start as usize..shared.end as usize];
            if shared.iter().any(|bits| bits & BELOW != 0) {
                let (one, other) = (root(parents, candidate as u32), root(parents, lower as u32));
                let (low, high) = (one.min(other), one.max(other));
                parents[high as usize] = low;
            }
            candidate += 1;
        }
    }
}

fn root(parents: &mut [u32], mut index: u32) -> u32 {
    while parents[index as usize] != index {
        let parent = parents[index as usize];
        parents[index as usize] = parents[parent as usize];
        index = parent;
    }
    index
}

/// Share of an island's sides that must be cliffs: without them it is a part of a surface that holes have cut off.
const CLIFF_MIN_FRACTION: f32 = 0.3;
