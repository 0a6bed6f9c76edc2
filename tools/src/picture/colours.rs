//! From a value to a colour.

use curvox::sink::Palette;

/// How values are coloured, in linear light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ColourMap {
    /// Curvatures: the palette from minus to plus `range`, black where |value| <= `band`.
    Signed {
        /// The two ends.
        palette: Palette,
        /// Values beyond take the colours of the ends.
        range: f32,
        /// Half the width of the black band.
        band: f32,
    },
    /// Magnitudes of errors: white at 0, red at half the range, black from the range on.
    Error {
        /// Where black begins.
        range: f32,
    },
}

impl ColourMap {
    /// The palette of a run's slices: a band of a thirtieth of the range.
    #[must_use]
    pub fn of_palette(palette: Palette, range: f32) -> Self {
        let band = range / 30.0;
        Self::Signed {
            palette,
            range,
            band,
        }
    }

    /// Least and most of the scale.
    #[must_use]
    pub fn ends(self) -> [f32; 2] {
        match self {
            Self::Signed { range, .. } => [-range, range],
            Self::Error { range } => [0.0, range],
        }
    }

    /// The colour of a value; what is not a number is black.
    #[must_use]
    pub fn colour(self, value: f32) -> [f32; 3] {
        match self {
            Self::Signed {
                palette,
                range,
                band,
            } => palette.colour_with_band(value, range, band / range),
            Self::Error { range } => {
                let share = value.abs() / range;
                if share < 0.5 {
                    let rest = 1.0 - 2.0 * share;
                    [1.0, rest, rest]
                } else {
                    // A NaN comes here and becomes black.
                    [(2.0 - 2.0 * share).max(0.0), 0.0, 0.0]
                }
            }
        }
    }
}
