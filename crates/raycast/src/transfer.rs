//! Transfer functions, given as points and converted to a table over integer HU.

use carina_isoregion::Rgba;

use crate::RaycastError;

/// Colour and opacity as functions of HU, linear between points.
#[derive(Debug, Clone, PartialEq)]
pub struct Transfer {
    points: Vec<[f64; 5]>,
    reference_mm: f64,
    bin_hu: i32,
}

impl Transfer {
    /// Create a transfer function from points `[hu, r, g, b, alpha]` in order of HU.
    ///
    /// Colours and opacities are 0 to 1; opacity is per `reference_mm`. Two points at one HU make a step; the later
    /// point applies at that HU. With `bin_hu` above 1 every bin of that width has the colour of its middle (the
    /// paper's quantised values).
    ///
    /// # Errors
    ///
    /// Returns an error if the points are not finite, not in order or out of range, or if a number is not valid.
    pub fn new(
        points: Vec<[f64; 5]>,
        reference_mm: f64,
        bin_hu: i32,
    ) -> Result<Self, RaycastError> {
        let refuse = |reason: String| Err(RaycastError::Transfer { reason });
        if points.is_empty() {
            return refuse("it has no points".to_owned());
        }
        for (n, p) in points.iter().enumerate() {
            if p.iter().any(|v| !v.is_finite()) {
                return refuse(format!("point {n} holds a value that is not finite: {p:?}"));
            }
            if p[1..].iter().any(|v| !(0.0..=1.0).contains(v)) {
                return refuse(format!(
                    "point {n} has a colour or opacity outside 0 to 1: {:?}",
                    &p[1..]
                ));
            }
            if n > 0 && p[0] < points[n - 1][0] {
                return refuse(format!(
                    "points must be in order of HU; point {n} at {} follows {}",
                    p[0],
                    points[n - 1][0]
                ));
            }
        }
        if !(reference_mm.is_finite() && reference_mm > 0.0) {
            return refuse(format!("its reference length is {reference_mm} mm"));
        }
        if !(1..=4096).contains(&bin_hu) {
            return refuse(format!("its bins are {bin_hu} HU wide"));
        }
        Ok(Self {
            points,
            reference_mm,
            bin_hu,
        })
    }

    /// Return colour and opacity per reference length at an integer HU.
    #[must_use]
    pub fn at(&self, hu: i32) -> Rgba {
        let hu = if self.bin_hu > 1 {
            f64::from(hu.div_euclid(self.bin_hu) * self.bin_hu) + f64::from(self.bin_hu - 1) / 2.0
        } else {
            f64::from(hu)
        };
        let after = self.points.partition_point(|p| p[0] <= hu);
        let colour = |p: &[f64; 5]| [p[1], p[2], p[3], p[4]];
        let Some(next) = self.points.get(after) else {
            return colour(&self.points[self.points.len() - 1]);
        };
        let Some(last) = after.checked_sub(1).map(|n| &self.points[n]) else {
            return colour(next);
        };
        let t = (hu - last[0]) / (next[0] - last[0]);
        // a + t (b - a): between two equal colours this is exactly that colour, so a constant section is one class.
        std::array::from_fn(|c| last[c + 1] + t * (next[c + 1] - last[c + 1]))
    }

    /// Return colour and opacity for every integer HU from `lo` to `hi`.
    #[must_use]
    pub fn range(&self, lo: i32, hi: i32) -> Vec<Rgba> {
        (lo..=hi).map(|hu| self.at(hu)).collect()
    }
}

/// Premultiplied colour and opacity that one ray step adds, as a table over integer HU.
#[derive(Debug, Clone, PartialEq)]
pub struct TransferTable {
    pub(crate) lo_hu: i32,
    pub(crate) last: i32,
    pub(crate) entries: Vec<[f32; 4]>,
    /// Index of the first entry with an opacity above 0.
    pub(crate) first_visible: i32,
    step_mm: f64,
}

impl TransferTable {
    /// Create a table for ray steps of `step_mm` over the values that a volume contains.
    ///
    /// The opacity of a step is `1 - (1 - alpha)^(step / reference)`, computed in f64 by a pure-Rust `pow`, so that
    /// tables are equal on all machines.
    ///
    /// # Errors
    ///
    /// Returns an error if the length of the step or the range of the values is not valid.
    pub fn new(
        transfer: &Transfer,
        step_mm: f64,
        lo_hu: i16,
        hi_hu: i16,
    ) -> Result<Self, RaycastError> {
        if !(step_mm.is_finite() && step_mm > 0.0) {
            return Err(RaycastError::Setting {
                what: "ray step",
                expected: "a length above 0 mm".to_owned(),
                found: format!("{step_mm} mm"),
            });
        }
        if lo_hu > hi_hu {
            return Err(RaycastError::Setting {
                what: "range of the transfer table",
                expected: "lowest value first".to_owned(),
                found: format!("{lo_hu} to {hi_hu}"),
            });
        }
        let exponent = step_mm / transfer.reference_mm;
        let mut last: Option<(Rgba, [f32; 4])> = None;
        let entries: Vec<[f32; 4]> = (i32::from(lo_hu)..=i32::from(hi_hu))
            .map(|hu| {
                let rgba = transfer.at(hu);
                // Long constant sections are common and `pow` is slow, so equal colours reuse the previous entry.
                if let Some((before, entry)) = last
                    && before.map(f64::to_bits) == rgba.map(f64::to_bits)
                {
                    return entry;
                }
                let alpha = 1.0 - libm::pow(1.0 - rgba[3], exponent);
                let entry =
                    [rgba[0] * alpha, rgba[1] * alpha, rgba[2] * alpha, alpha].map(|v| v as f32);
                last = Some((rgba, entry));
                entry
            })
            .collect();
        Ok(Self {
            lo_hu: i32::from(lo_hu),
            last: i32::from(hi_hu) - i32::from(lo_hu),
            first_visible: entries.iter().take_while(|entry| entry[3] <= 0.0).count() as i32,
            entries,
            step_mm,
        })
    }

    /// Return the entry of an interpolated value: that of the integer `floor(value + 0.5)`, clamped to the table.
    #[inline(always)]
    pub(crate) fn at(&self, value: f32) -> [f32; 4] {
        // SAFETY: interpolated int16 values are finite and within +-32768.5, so the result fits an i32. A checked
        // conversion costs a tenth of the brute-force caster (`whole` in `sampling`).
        let hu: i32 = unsafe { (value + 0.5).floor().to_int_unchecked() };
        self.at_hu(hu)
    }

    /// Return the colour and opacity of an integer value; a value outside the table has those of the table's first or
    /// last entry.
    #[inline(always)]
    pub(crate) fn at_hu(&self, hu: i32) -> [f32; 4] {
        let n = (hu - self.lo_hu).clamp(0, self.last) as usize;
        debug_assert!(n < self.entries.len());
        // SAFETY: `n` is at most `last`, the index of the last entry; a table has at least one entry. Benchmark: this
        // is one of two loads of a clear sample.
        unsafe { *self.entries.get_unchecked(n) }
    }

    /// Return the premultiplied colour and opacity of one step at an integer value, clamped to the table.
    #[must_use]
    pub fn entry(&self, hu: i32) -> [f32; 4] {
        self.at_hu(hu.clamp(-40_000, 40_000))
    }

    /// Return the length in mm of a ray step, for which the table's opacities were computed.
    #[must_use]
    pub const fn step_mm(&self) -> f64 {
        self.step_mm
    }

    /// Return true if no entry from `lo_hu` to `hi_hu` has an opacity above 0.
    #[must_use]
    pub fn is_transparent(&self, lo_hu: i32, hi_hu: i32) -> bool {
        (lo_hu..=hi_hu).all(|hu| self.at_hu(hu)[3] == 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> Transfer {
        Transfer::new(
            vec![
                [-700.0, 0.0, 0.0, 0.0, 0.0],
                [-300.0, 1.0, 0.5, 0.25, 0.8],
                [100.0, 1.0, 0.5, 0.25, 0.8],
            ],
            1.0,
            1,
        )
        .unwrap()
    }

    #[test]
    fn colours_are_linear_between_points_and_flat_beyond() {
        let t = ramp();
        assert_eq!(t.at(-1000), [0.0; 4]);
        assert_eq!(t.at(-500), [0.5, 0.25, 0.125, 0.4]);
        assert_eq!(t.at(-17), t.at(2000));
    }

    #[test]
    fn two_points_at_one_hu_make_a_step() {
        let t = Transfer::new(
            vec![
                [0.0, 1.0, 1.0, 1.0, 0.0],
                [10.0, 1.0, 1.0, 1.0, 0.0],
                [10.0, 1.0, 1.0, 1.0, 1.0],
            ],
            1.0,
            1,
        )
        .unwrap();
        assert_eq!(t.at(9)[3], 0.0);
        assert_eq!(t.at(10)[3], 1.0);
    }

    #[test]
    fn the_opacity_of_a_wall_does_not_depend_on_the_ray_step() {
        let through = |step_mm: f64| {
            let table = TransferTable::new(&ramp(), step_mm, -1024, 3071).unwrap();
            (1.0 - f64::from(table.at(40.0)[3])).powf(2.0 / step_mm)
        };
        // Both rays cross 2 mm of opacity 0.8 per mm; the tolerance of 1e-5 allows for f32 entries to the 8th power.
        assert!((through(2.0) - 0.04).abs() < 1e-5);
        assert!((through(0.25) - 0.04).abs() < 1e-5);
    }

    #[test]
    fn samples_read_the_nearest_integer_and_clamp_at_the_ends() {
        let table = TransferTable::new(&ramp(), 1.0, -600, 0).unwrap();
        assert_eq!(table.at(-500.5), table.at_hu(-500));
        assert_eq!(table.at(-500.51), table.at_hu(-501));
        assert_eq!(table.at(-9000.0), table.at_hu(-600));
        assert_eq!(table.at(9000.0), table.at_hu(0));
    }

    #[test]
    fn invalid_transfer_functions_are_rejected() {
        for points in [
            vec![],
            vec![[0.0, 2.0, 0.0, 0.0, 0.0]],
            vec![[f64::NAN, 0.0, 0.0, 0.0, 0.0]],
            vec![[1.0, 0.0, 0.0, 0.0, 0.0], [0.0; 5]],
        ] {
            assert_eq!(
                Transfer::new(points, 1.0, 1).unwrap_err().code(),
                "render.transfer"
            );
        }
        assert!(Transfer::new(vec![[0.0; 5]], 0.0, 1).is_err());
        assert!(TransferTable::new(&ramp(), 0.0, 0, 1).is_err());
    }
}
