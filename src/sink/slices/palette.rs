//! Colours of the curvature preview.
//!
//! Comes in: a value and the range it is shown in. Goes out: linear light R, G, B. Colours run from
//! the palette's negative end through white at 0 to its positive end; a thin black band at 0 makes
//! the line of vanishing curvature visible, as in the figures of *Corrected curvature measures*.

/// Half the width of the black band at 0, as a share of the range: [-0.01, 0.01] of ±0.3.
const BAND: f32 = 0.01 / 0.3;

/// Pairs of colours for negative and positive curvature.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Palette {
    /// Dark blue, white, red: the map of the paper.
    #[default]
    BlueRed,
    /// Blue, white, orange: told apart with any colour vision (after Okabe and Ito).
    BlueOrange,
}

impl std::str::FromStr for Palette {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "blue-red" => Ok(Palette::BlueRed),
            "blue-orange" => Ok(Palette::BlueOrange),
            other => Err(format!("found {other:?}, expected blue-red or blue-orange")),
        }
    }
}

impl Palette {
    /// The name on the command line and in headers.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Palette::BlueRed => "blue-red",
            Palette::BlueOrange => "blue-orange",
        }
    }

    /// Linear light colours of the two ends.
    const fn ends(self) -> [[f32; 3]; 2] {
        match self {
            // sRGB #00008B and #FF0000.
            Palette::BlueRed => [[0.0, 0.0, 0.258], [1.0, 0.0, 0.0]],
            // sRGB #0072B2 and #D55E00.
            Palette::BlueOrange => [[0.0, 0.168, 0.445], [0.665, 0.112, 0.0]],
        }
    }

    /// The colour of `value` when ±`range` is the whole scale; values beyond take its ends.
    #[must_use]
    pub fn colour(self, value: f32, range: f32) -> [f32; 3] {
        self.colour_with_band(value, range, BAND)
    }

    /// The same with a black band of another half width, as a share of the range.
    #[must_use]
    pub fn colour_with_band(self, value: f32, range: f32, band: f32) -> [f32; 3] {
        let t = value / range;
        // A NaN fails this test and is black too.
        if t.is_nan() || t.abs() <= band {
            return [0.0; 3];
        }
        let [negative, positive] = self.ends();
        let end = if t < 0.0 { negative } else { positive };
        let share = t.abs().min(1.0);
        end.map(|channel| (1.0 - share) + channel * share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_are_dark_blue_and_red_and_the_band_is_black() {
        let colour = |value| Palette::BlueRed.colour(value, 0.3);
        assert_eq!(colour(-0.5), [0.0, 0.0, 0.258]);
        assert_eq!(colour(0.3), [1.0, 0.0, 0.0]);
        assert_eq!(colour(0.0), [0.0; 3]);
        assert_eq!(colour(-0.009), [0.0; 3]);
        assert!(colour(0.011).iter().all(|&c| c > 0.9));
        assert_eq!(colour(f32::NAN), [0.0; 3]);
    }
}
