//! How often a run asks for memory: by bricks and slabs, not by surfels.
//!
//! A test of its own, as it counts what the whole program allocates.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicU64, Ordering};

use curvox::lattice::Lattice;
use curvox::measure::ball::{Compensation, Weights};
use curvox::normal::Estimator;
use curvox::pipeline::Settings;
use curvox_tools::plain::Solid;

#[allow(dead_code)]
mod common;

/// Counts and passes on.
struct Counting;

static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

// SAFETY: every call is handed on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: as the caller promised.
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

const DIMS: [usize; 3] = [128, 128, 64];

/// Plates four voxels thick, eight voxels apart, of which a thousandth of the voxels are flipped.
fn plates(count: usize) -> Solid {
    let mut random = common::Random(count as u64);
    let mut inside = Vec::new();
    for z in 0..DIMS[2] {
        let solid = z % 8 < 4 && z / 8 < count;
        inside.extend((0..DIMS[0] * DIMS[1]).map(|_| solid != (random.next() < 0.001)));
    }
    Solid { dims: DIMS, inside }
}

/// Surfels and allocations of a run.
fn run(solid: &Solid, settings: &Settings) -> [u64; 2] {
    let before = ALLOCATIONS.load(Ordering::Relaxed);
    let (rows, _) = common::piped(solid, settings);
    let after = ALLOCATIONS.load(Ordering::Relaxed);
    [rows.k[0].len() as u64, after - before]
}

#[test]
fn runs_allocate_by_bricks_and_planes_and_not_by_surfels() {
    let lattice = Lattice::new(DIMS.map(|n| n as u64), [1.0; 3], false).unwrap();
    let mut default = Settings::new(lattice);
    default.threads = 1;
    default.radii = vec![3.0];
    let integral = default.clone();
    default.estimator = Estimator::SurfaceAverage { radius: 3.6 };
    default.weights = Weights::Compensated(Compensation::Averaged);
    for settings in [default, integral] {
        let [few, many] = [1, 7].map(|count| run(&plates(count), &settings));
        let [surfels, allocations] = [0, 1].map(|i| many[i] - few[i]);
        assert!(surfels > 150_000, "{few:?} {many:?}");
        println!("{few:?} {many:?}");
        assert!(100 * allocations < surfels, "{few:?} {many:?}");
    }
}
