//! Random numbers that depend only on a seed and a position or purpose.

/// Return 64 bits in which neighbouring inputs give unrelated outputs (the finalizer of `SplitMix64`).
pub(crate) const fn mixed(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Stream of random numbers (`SplitMix64`).
#[derive(Debug, Clone)]
pub(crate) struct Random(u64);

impl Random {
    /// Create the stream of a seed for one purpose.
    ///
    /// Streams of different purposes are unrelated, so that, for example, a nodule does not change the airways.
    pub(crate) const fn new(seed: u64, purpose: u64) -> Self {
        Self(mixed(
            mixed(seed) ^ purpose.wrapping_mul(0xd6e8_feb8_6659_fd93),
        ))
    }

    /// Return a uniform random number in `0..1`.
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        // The 53 bits give all multiples of 2^-53 in 0..1.
        (mixed(self.0) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Return a uniform random number in `lo..hi`.
    pub(crate) fn range(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }

    /// Return a random direction within `angle_rad` of `dir`.
    ///
    /// The angle is uniform, not the solid angle, so directions near `dir` are more frequent.
    pub(crate) fn near(&mut self, dir: [f64; 3], angle_rad: f64) -> [f64; 3] {
        let (across, up) = crate::shapes::normals(dir);
        let turn = self.range(0.0, core::f64::consts::TAU);
        let tilt = self.range(0.0, angle_rad);
        crate::shapes::tilted(dir, across, up, turn, tilt)
    }
}

/// Return smooth random values in -1..1 at a point (value noise), with features of one lattice unit.
pub(crate) fn value_noise(seed: u64, p: [f64; 3]) -> f64 {
    let cell = p.map(f64::floor);
    let t: [f64; 3] = std::array::from_fn(|a| {
        let f = p[a] - cell[a];
        f * f * (3.0 - 2.0 * f)
    });
    let at = |dx: i64, dy: i64, dz: i64| -> f64 {
        let (x, y, z) = (
            cell[0] as i64 + dx,
            cell[1] as i64 + dy,
            cell[2] as i64 + dz,
        );
        let key =
            (x as u64 & 0x1f_ffff) | (y as u64 & 0x1f_ffff) << 21 | (z as u64 & 0x1f_ffff) << 42;
        (mixed(seed ^ key) >> 40) as f64 * (2.0 / (1u64 << 24) as f64) - 1.0
    };
    let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
    let plane = |dz: i64| {
        mix(
            mix(at(0, 0, dz), at(1, 0, dz), t[0]),
            mix(at(0, 1, dz), at(1, 1, dz), t[0]),
            t[1],
        )
    };
    mix(plane(0), plane(1), t[2])
}
