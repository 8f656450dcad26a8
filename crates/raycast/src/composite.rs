//! Front-to-back compositing of the samples of one ray.

/// Value of [`Gathered::hit`] for a ray that meets no wall.
pub(crate) const NO_HIT: f32 = -1.0;

/// Colour, transparency and first wall that a ray has accumulated so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gathered {
    /// Premultiplied colour of the accumulated samples.
    pub rgb: [f32; 3],
    /// Transparency of the accumulated samples: the share of light from behind that still passes.
    pub transparency: f32,
    /// Distance from the camera, in ray steps, where the transparency falls below 1/2; [`NO_HIT`] if it never does.
    ///
    /// Casters compute this distance only if their parameter `HITS` is true.
    pub hit: f32,
}

impl Gathered {
    /// State of a ray before its first sample: no colour, full transparency, no wall.
    pub(crate) const NOTHING: Self = Self {
        rgb: [0.0; 3],
        transparency: 1.0,
        hit: NO_HIT,
    };

    /// Add the premultiplied colour and the opacity of sample `k` behind the accumulated samples.
    #[inline(always)]
    pub(crate) fn add<const HITS: bool>(&mut self, k: u32, rgb: [f32; 3], alpha: f32) {
        for c in 0..3 {
            self.rgb[c] = self.transparency.mul_add(rgb[c], self.rgb[c]);
        }
        let before = self.transparency;
        self.transparency *= 1.0 - alpha;
        if HITS {
            self.cross(k, before, self.transparency);
        }
    }

    /// Store the position of the first wall if the transparency falls below 1/2 within sample `k`.
    ///
    /// The sample extends from `k` to `k + 1` steps. `before` and `after` are the transparencies before and after the
    /// sample.
    #[inline(always)]
    pub(crate) fn cross(&mut self, k: u32, before: f32, after: f32) {
        if before >= 0.5 && after < 0.5 {
            self.hit = k as i32 as f32 + (before - 0.5) / (before - after);
        }
    }

    /// Add a skipped segment of the ray with its colour and transparency (`[r, g, b, transparency]`) behind the
    /// accumulated samples.
    #[inline(always)]
    pub(crate) fn add_segment(&mut self, segment: [f32; 4]) {
        for c in 0..3 {
            self.rgb[c] = self.transparency.mul_add(segment[c], self.rgb[c]);
        }
        self.transparency *= segment[3];
    }

    /// Return the accumulated colour over a background, with 8 bits per channel.
    #[inline(always)]
    pub(crate) fn to_rgb8(self, background: [f32; 3]) -> [u8; 3] {
        std::array::from_fn(|c| {
            let v = self.transparency.mul_add(background[c], self.rgb[c]);
            // The cast saturates, so light above 1 is white.
            v.mul_add(255.0, 0.5) as u8
        })
    }
}
