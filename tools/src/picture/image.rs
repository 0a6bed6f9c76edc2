//! A picture in memory.

/// Rows of 8-bit sRGB pixels, from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    size: [usize; 2],
    pixels: Vec<[u8; 3]>,
}

impl Image {
    /// A white picture, of width and height in pixels.
    #[must_use]
    pub fn white(size: [usize; 2]) -> Self {
        Self {
            size,
            pixels: vec![[255; 3]; size[0] * size[1]],
        }
    }

    /// Width and height.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// The pixel in column `x` of row `y`.
    ///
    /// # Panics
    ///
    /// If there is no such pixel.
    #[must_use]
    pub fn pixel(&self, x: usize, y: usize) -> [u8; 3] {
        assert!(x < self.size[0]);
        self.pixels[y * self.size[0] + x]
    }

    /// The same with each channel rounded to one of 52 values: smaller files, and steps too small to be
    /// seen as lines.
    #[must_use]
    pub fn with_few_shades(mut self) -> Self {
        // 51 steps of 5 from black to white, which stay as they are.
        for channel in self.pixels.as_flattened_mut() {
            *channel = ((u16::from(*channel) + 2) / 5 * 5) as u8;
        }
        self
    }

    /// The pixels of row `y`.
    pub(super) fn row(&self, y: usize) -> &[[u8; 3]] {
        &self.pixels[y * self.size[0]..][..self.size[0]]
    }

    /// Copies the part of another picture that is within this one, its upper left corner to `at`.
    pub(super) fn paste(&mut self, at: [usize; 2], other: &Image) {
        let width = other.size[0].min(self.size[0].saturating_sub(at[0]));
        let height = other.size[1].min(self.size[1].saturating_sub(at[1]));
        for y in 0..height {
            let start = (at[1] + y) * self.size[0] + at[0];
            self.pixels[start..start + width].copy_from_slice(&other.row(y)[..width]);
        }
    }

    /// Paints the part of a rectangle that is within the picture.
    pub(super) fn fill(&mut self, at: [usize; 2], size: [usize; 2], colour: [u8; 3]) {
        let [left, right] = [at[0], at[0] + size[0]].map(|x| x.min(self.size[0]));
        let [top, bottom] = [at[1], at[1] + size[1]].map(|y| y.min(self.size[1]));
        for y in top..bottom {
            self.pixels[y * self.size[0]..][left..right].fill(colour);
        }
    }
}

/// The 8-bit sRGB pixel of linear light, clamped.
pub(super) fn srgb(linear: [f32; 3]) -> [u8; 3] {
    linear.map(|channel| {
        // A NaN stays one, and becomes 0 in the last line.
        let light = channel.clamp(0.0, 1.0);
        let encoded = if light <= 0.003_130_8 {
            12.92 * light
        } else {
            // The same on every machine, unlike the power of the system's library.
            1.055 * libm::powf(light, 1.0 / 2.4) - 0.055
        };
        // Within 0..=255 by the clamp.
        (encoded * 255.0 + 0.5) as u8
    })
}
