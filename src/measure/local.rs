//! The measures of a brick's core and halo, in the form the sums over balls read.

use super::cells::{Around, CellMeasures, Lumped, Tensor, Umbrellas};
use super::surface::Surface;

/// Measures of all surfels of a [`Surface`], in the form the sums read.
#[derive(Clone, Debug)]
pub struct LocalMeasures {
    pub(super) marks: Vec<u8>,
    pub(super) lumped: Vec<Lumped>,
    /// mu_Omega lumped on surfels, if it was evaluated.
    pub(super) omega: Vec<i64>,
    pub(super) cells: Option<Box<LocalCells>>,
}

/// Unlumped measures, and which linel and umbrella each side and corner of a surfel is.
#[derive(Clone, Debug)]
pub(super) struct LocalCells {
    pub(super) mu0: Vec<i64>,
    pub(super) linels: Vec<Tensor>,
    pub(super) umbrellas: Vec<i64>,
    /// mu_Omega of each linel, if it was evaluated.
    pub(super) omega: Vec<i64>,
    pub(super) degree: Vec<u8>,
    pub(super) linel_of: Vec<[u32; 4]>,
    pub(super) umbrella_of: Vec<[u32; 4]>,
}

/// No linel or umbrella: it is on the border of the image or leaves the box.
pub(super) const NONE: u32 = u32::MAX;

impl LocalMeasures {
    /// Takes measures gathered for all surfels of a surface, in order.
    ///
    /// # Panics
    /// If there are not as many as surfels.
    #[must_use]
    pub fn new(surface: &Surface, gathered: CellMeasures) -> Self {
        assert_eq!(gathered.marks.len(), surface.len(), "one mark a surfel");
        if gathered.owned_from.is_empty() {
            assert_eq!(gathered.lumped.len(), surface.len(), "one lump a surfel");
            return Self {
                marks: gathered.marks,
                lumped: gathered.lumped,
                omega: gathered.omega,
                cells: None,
            };
        }
        let marks = gathered.marks.clone();
        let cells = Some(Box::new(LocalCells::new(surface, gathered)));
        Self {
            marks,
            lumped: Vec::new(),
            omega: Vec::new(),
            cells,
        }
    }
}

impl LocalCells {
    fn new(surface: &Surface, gathered: CellMeasures) -> Self {
        let count = surface.len();
        let mut linel_of = vec![[NONE; 4]; count];
        let mut umbrella_of = vec![[NONE; 4]; count];
        let mut degree = vec![0; gathered.umbrellas.len()];
        let mut umbrellas = Umbrellas::of(surface);
        for i in 0..count {
            let [mut linel, mut pointel] = gathered.owned_from[i];
            let end = gathered.owned_from[i + 1];
            for j in 0..4 {
                let link = surface.links.of[i][j];
                match link.surfel() {
                    // Surfels at the edge of the box may own linels that leave it; those are
                    // out of every ball, and the next surfel starts at its own offset.
                    Some(n) if n > i && linel < end[0] => {
                        linel_of[i][j] = linel;
                        linel_of[n][link.side_there()] = linel;
                        linel += 1;
                    }
                    _ => {}
                }
                if umbrellas.find(i, j) == Around::Cycle {
                    if pointel == end[1] {
                        continue;
                    }
                    degree[pointel as usize] = umbrellas.corners.len() as u8;
                    for &corner in &umbrellas.corners {
                        umbrella_of[corner as usize / 4][corner as usize % 4] = pointel;
                    }
                    pointel += 1;
                }
            }
        }
        Self {
            mu0: gathered.mu0,
            linels: gathered.linels,
            umbrellas: gathered.umbrellas,
            omega: gathered.omega,
            degree,
            linel_of,
            umbrella_of,
        }
    }
}
