//! Front-to-back compositing of one ray.

/// What a ray has gathered.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Gathered {
    /// Premultiplied colour.
    pub rgb: [f32; 3],
    /// What still shines through.
    pub transparency: f32,
}

impl Gathered {
    pub(crate) const NOTHING: Self = Self {
        rgb: [0.0; 3],
        transparency: 1.0,
    };

    /// Adds a sample of premultiplied colour behind what is there.
    #[inline(always)]
    pub(crate) fn add(&mut self, rgb: [f32; 3], alpha: f32) {
        for c in 0..3 {
            self.rgb[c] = self.transparency.mul_add(rgb[c], self.rgb[c]);
        }
        self.transparency *= 1.0 - alpha;
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
