//! Source of the rays of a band of rows, in the order in which packets cast them.

use super::{
    lanes::MAX_LANES,
    out::Out,
    pool::{BATCH, Pool},
    setup::{Directions, Patch, count_up, rays_of},
};
use crate::{Frame, leap::Start};

/// Number of rows of a picture that are cast together, so that packets cover squares of pixels.
pub(crate) const BAND_ROWS: usize = 4;
/// Maximum number of rays of a patch of pixels that is set up at once: half of the largest number of lanes.
const PATCH: usize = MAX_LANES / 2;

/// Rays of a band of rows that are not set up yet.
///
/// The rays are set up patch by patch, so that a packet covers a square of pixels.
pub(super) struct Source {
    width: usize,
    first_row: usize,
    num_rows: usize,
    /// Column, in the band, of the first pixel whose ray is not set up yet.
    column: usize,
    row: usize,
    sum_of_first: u64,
}

impl Source {
    pub(super) fn new(width: usize, first_row: usize, num_rows: usize) -> Self {
        Self {
            width,
            first_row,
            num_rows,
            column: 0,
            row: 0,
            sum_of_first: 0,
        }
    }

    pub(super) fn num_rays(&self) -> usize {
        self.width * self.num_rows
    }

    #[inline(always)]
    pub(super) fn is_empty(&self) -> bool {
        self.row == self.num_rows
    }

    /// Return the sum of the indices of the first samples of the rays that are set up so far.
    pub(super) fn sum_of_first(&self) -> u64 {
        self.sum_of_first
    }

    /// Return the next patch of pixels: a square in a band of four rows; empty at the end of the band.
    #[inline(always)]
    fn next_patch(&mut self) -> Patch {
        let num_rows = (self.num_rows - self.row).min(BAND_ROWS);
        let num_columns = (PATCH / num_rows.max(1)).min(self.width - self.column);
        let columns = self.column..self.column + num_columns;
        let rows = self.row..self.row + num_rows;
        self.column = columns.end;
        if self.column == self.width {
            (self.column, self.row) = (0, rows.end);
        }
        (columns, rows)
    }

    /// Set up rays and add them to an empty pool.
    ///
    /// If none of the pixels of a patch has a ray, these pixels are written to `out` at once.
    #[inline(always)]
    pub(super) fn set_up<O: Out>(
        &mut self,
        frame: &Frame<'_>,
        start: Start,
        pool: &mut Pool,
        out: &mut O,
    ) {
        while pool.len() < BATCH && !self.is_empty() {
            let patches = [self.next_patch(), self.next_patch()];
            let mut in_picture = patches.clone();
            for (_, rows) in &mut in_picture {
                *rows = self.first_row + rows.start..self.first_row + rows.end;
            }
            let directions = Directions::of(frame, in_picture.into_iter());
            if directions.have_no_ray() {
                for (columns, rows) in patches {
                    for row in rows {
                        let at = row * self.width;
                        out.write_nothing(at + columns.start..at + columns.end);
                    }
                }
                continue;
            }
            let mut pixel = [0; MAX_LANES];
            let mut count = 0;
            for (columns, rows) in patches {
                for row in rows {
                    let end = count + columns.len();
                    let first = row * self.width + columns.start;
                    count_up(&mut pixel[count..end], first as i32, 1);
                    count = end;
                }
            }
            let rays = rays_of(frame, &directions);
            pool.add(&rays, &pixel, count, start);
            for n in 0..count {
                self.sum_of_first += rays.first[n] as u64;
            }
        }
    }
}
