//! Front-to-back compositing of one ray.

/// `hit` of a ray that meets no wall.
pub(crate) const NO_HIT: f32 = -1.0;

/// What a ray has gathered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gathered {
    /// Premultiplied colour.
    pub rgb: [f32; 3],
    /// What still shines through.
    pub transparency: f32,
    /// Where the transparency falls below 1/2, in steps from the camera; [`NO_HIT`] where it does not. Only kept by
    /// those who ask for it.
    pub hit: f32,
}

impl Gathered {
    pub(crate) const NOTHING: Self = Self {
        rgb: [0.0; 3],
        transparency: 1.0,
        hit: NO_HIT,
    };

    /// Adds sample `k` of premultiplied colour behind what is there.
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

    /// Notes the first wall if the transparency falls below 1/2 within sample `k`, which reaches from `k` to `k + 1`
    /// steps.
    #[inline(always)]
    pub(crate) fn cross(&mut self, k: u32, before: f32, after: f32) {
        if before >= 0.5 && after < 0.5 {
            self.hit = k as i32 as f32 + (before - 0.5) / (before - after);
        }
    }

    /// Adds a segment given by its colour and its transparency.
    #[inline(always)]
    pub(crate) fn add_segment(&mut self, segment: [f32; 4]) {
        for c in 0..3 {
            self.rgb[c] = self.transparency.mul_add(segment[c], self.rgb[c]);
        }
        self.transparency *= segment[3];
    }

    /// Eight bits per channel over a background.
    #[inline(always)]
    pub(crate) fn to_rgb8(self, background: [f32; 3]) -> [u8; 3] {
        std::array::from_fn(|c| {
            let v = self.transparency.mul_add(background[c], self.rgb[c]);
            // The cast saturates, so light above 1 is white.
            v.mul_add(255.0, 0.5) as u8
        })
    }
}
