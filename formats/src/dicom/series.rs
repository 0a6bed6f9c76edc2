//! Which volumes a set of images holds, and which of them is wanted.
//!
//! In: images. Out: [`Stack`]s: the planes of one series that have the same size, type,
//! orientation and pixel spacing, at most one at each position. Where positions repeat (points
//! in time, echoes, b-values, segments), the first labels of [`LABELS`] that tell them apart cut
//! the series; a label cuts only into as many parts as planes share a position, so that one that
//! changes from slice to slice is not taken for time. What no label tells apart stays together,
//! and is refused when it is chosen.

use std::collections::HashMap;

use crate::error::Error;
use crate::options::OpenOptions;

use super::image::{Frame, Image, LABELS, SampleKind, Words};

/// A plane: a frame of an image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub(super) image: usize,
    pub(super) frame: usize,
}

impl Plane {
    pub(super) fn frame(self, images: &[Image]) -> &Frame {
        &images[self.image].frames[self.frame]
    }

    /// Its file, and its number there if it has several.
    pub(super) fn name(self, images: &[Image]) -> String {
        let image = &images[self.image];
        let file = image.place.short_name();
        if image.frames.len() > 1 {
            format!("{file} frame {}", self.frame + 1)
        } else {
            file
        }
    }
}

/// Planes that make a volume.
#[derive(Debug)]
pub(super) struct Stack {
    /// At least one.
    pub(super) planes: Vec<Plane>,
    /// What tells it from others of its series.
    label: String,
}

impl Stack {
    /// One line of a list.
    fn line(&self, number: usize, images: &[Image]) -> String {
        let image = &images[self.planes[0].image];
        let mut line = format!("{number}: ");
        if let Some(series) = image.series_number {
            line += &format!("series {series} ");
        }
        if !image.description.is_empty() {
            line += &format!("'{}' ", image.description);
        }
        line += &format!(
            "{} {} x {} x {}",
            image.modality,
            image.columns,
            image.rows,
            self.planes.len()
        );
        if !self.label.is_empty() {
            line += &format!(" ({})", self.label);
        }
        line
    }

    pub(super) fn label(&self) -> &str {
        &self.label
    }
}

/// What all planes of a stack share exactly.
#[derive(PartialEq, Eq, Hash)]
struct Key<'a> {
    series: &'a str,
    size: [u16; 2],
    allocated: u16,
    kind: SampleKind,
    samples: u16,
    placed: bool,
    oriented: bool,
    /// Frames without positions belong to their file alone.
    alone: Option<usize>,
}

/// The stacks of all images, in the order of series numbers.
pub(super) fn stacks(images: &[Image], words: &Words) -> Vec<Stack> {
    let mut groups: HashMap<Key<'_>, usize> = HashMap::new();
    // By exact key, then by orientation and spacing.
    let mut parts: Vec<Vec<Vec<Plane>>> = Vec::new();
    for (i, image) in images.iter().enumerate() {
        for (f, frame) in image.frames.iter().enumerate() {
            let placed = frame.position.is_some() && frame.normal().is_some();
            let key = Key {
                series: &image.series_uid,
                size: [image.columns, image.rows],
                allocated: image.allocated,
                kind: image.kind,
                samples: image.samples,
                placed,
                oriented: frame.orientation.is_some(),
                alone: (image.frames.len() > 1 && !placed).then_some(i),
            };
            let group = *groups.entry(key).or_insert_with(|| {
                parts.push(Vec::new());
                parts.len() - 1
            });
            let plane = Plane { image: i, frame: f };
            let alike = parts[group]
                .iter_mut()
                .find(|part| is_alike(part[0].frame(images), frame));
            match alike {
                Some(part) => part.push(plane),
                None => parts[group].push(vec![plane]),
            }
        }
    }
    let mut stacks = Vec::new();
    for planes in parts.into_iter().flatten() {
        let all = Stack {
            planes,
            label: String::new(),
        };
        split(all, 0, images, words, &mut stacks);
    }
    stacks.sort_by_cached_key(|stack| {
        let image = &images[stack.planes[0].image];
        (image.series_number, image.series_uid.clone())
    });
    stacks
}

/// Whether two planes can lie in one volume: the same directions and spacing, but for rounding.
fn is_alike(a: &Frame, b: &Frame) -> bool {
    /// Of a direction: a thousandth of a radian. Of a spacing: relative.
    const ROUNDING: f64 = 1e-3;
    let directions = match (a.orientation, b.orientation) {
        (Some(a), Some(b)) => a.iter().zip(b).all(|(a, b)| (a - b).abs() < ROUNDING),
        (None, None) => true,
        _ => false,
    };
    let spacing = match (a.spacing, b.spacing) {
        (Some(a), Some(b)) => a
            .iter()
            .zip(b)
            .all(|(a, b)| (a - b).abs() <= ROUNDING * a.abs()),
        (None, None) => true,
        _ => false,
    };
    directions && spacing
}

/// Where a plane lies along the normal of `first`, or its number if it has no position.
pub(super) fn along(plane: &Frame, first: &Frame) -> Option<f64> {
    match (plane.position, first.normal()) {
        (Some(p), Some(n)) => Some(p[0] * n[0] + p[1] * n[1] + p[2] * n[2]),
        _ => plane.number.map(|n| n as f64),
    }
}

/// Planes nearer than this, in mm, are at the same position.
pub(super) const SAME_POSITION: f64 = 1e-4;

/// The most planes at one position.
fn most_at_one_place(planes: &[Plane], images: &[Image]) -> usize {
    let first = planes[0].frame(images);
    let mut places: Vec<_> = planes
        .iter()
        .filter_map(|plane| along(plane.frame(images), first))
        .collect();
    places.sort_by(f64::total_cmp);
    let mut most = 1;
    let mut run = 1;
    for pair in places.windows(2) {
        run = if pair[1] - pair[0] <= SAME_POSITION {
            run + 1
        } else {
            1
        };
        most = most.max(run);
    }
    most
}

/// Cuts a stack in which positions repeat, by labels from `from` on.
fn split(stack: Stack, from: usize, images: &[Image], words: &Words, out: &mut Vec<Stack>) {
    let most = most_at_one_place(&stack.planes, images);
    if most > 1 {
        for label in from..LABELS.len() {
            let mut parts: HashMap<u32, Vec<Plane>> = HashMap::new();
            for plane in &stack.planes {
                let number = plane.frame(images).labels[label];
                parts.entry(number).or_default().push(*plane);
            }
            if parts.len() < 2 || parts.len() > most {
                continue;
            }
            let mut parts: Vec<_> = parts.into_iter().collect();
            parts.sort_by(|(a, _), (b, _)| {
                let (a, b) = (words.word(*a), words.word(*b));
                match (a.parse::<f64>(), b.parse::<f64>()) {
                    (Ok(a), Ok(b)) => a.total_cmp(&b),
                    _ => a.cmp(b),
                }
            });
            for (number, planes) in parts {
                let mut text = stack.label.clone();
                if !text.is_empty() {
                    text += ", ";
                }
                text += &format!("{} {}", LABELS[label].0, words.word(number));
                let part = Stack {
                    planes,
                    label: text,
                };
                split(part, label + 1, images, words, out);
            }
            return;
        }
    }
    out.push(stack);
}

/// The stack that is wanted, and warnings on what was left.
pub(super) fn choose(
    stacks: Vec<Stack>,
    images: &[Image],
    name: &str,
    options: &OpenOptions,
) -> Result<(Stack, Vec<String>), Error> {
    let candidates: Vec<usize> = match &options.dataset {
        None => (0..stacks.len())
            .filter(|&i| stacks[i].planes.len() > 1)
            .collect(),
        Some(wanted) => named(&stacks, images, wanted),
    };
    let list = |of: &[usize]| {
        /// Longer lists help nobody.
        const MOST_LINES: usize = 40;
        let mut lines: Vec<_> = of
            .iter()
            .take(MOST_LINES)
            .map(|&i| stacks[i].line(i, images))
            .collect();
        if of.len() > MOST_LINES {
            lines.push(format!("and {} more", of.len() - MOST_LINES));
        }
        lines.join("; ")
    };
    let all: Vec<_> = (0..stacks.len()).collect();
    let chosen = match (candidates.as_slice(), options.frame, &options.dataset) {
        ([], _, Some(wanted)) => {
            return Err(Error::unsupported(
                name,
                format!("there is no DICOM series '{wanted}': {}", list(&all)),
            ));
        }
        ([], _, None) => {
            return Err(Error::unsupported(
                name,
                format!(
                    "no DICOM series has more than one plane ({}): a volume is needed; name the \
                     folder that holds the files of its series",
                    list(&all)
                ),
            ));
        }
        ([only], None | Some(0), _) => *only,
        (several, Some(frame), _) if is_one_series(&stacks, images, several) => {
            let found = usize::try_from(frame).ok().and_then(|f| several.get(f));
            *found.ok_or_else(|| {
                Error::unsupported(
                    name,
                    format!(
                        "frame {frame} was asked for, there are {}: {}",
                        several.len(),
                        list(several)
                    ),
                )
            })?
        }
        (several, _, _) => {
            return Err(Error::unsupported(
                name,
                format!(
                    "DICOM has several volumes here: {}; choose one with --dataset and the number before its colon, its UID or its \
                     description",
                    list(several)
                ),
            ));
        }
    };
    let mut warnings = Vec::new();
    if options.dataset.is_none() && candidates.len() == 1 && stacks.len() > 1 {
        let others: Vec<_> = all.iter().copied().filter(|&i| i != chosen).collect();
        warnings.push(format!(
            "{name}: single planes beside the volume were left out: {}",
            list(&others)
        ));
    }
    let mut stacks = stacks;
    Ok((stacks.swap_remove(chosen), warnings))
}

/// Stacks by number, series UID or description.
fn named(stacks: &[Stack], images: &[Image], wanted: &str) -> Vec<usize> {
    let by = |is: &dyn Fn(&Image) -> bool| -> Vec<usize> {
        (0..stacks.len())
            .filter(|&i| is(&images[stacks[i].planes[0].image]))
            .collect()
    };
    let by_name = by(&|image| {
        image.series_uid == wanted
            || (!wanted.is_empty() && image.description.eq_ignore_ascii_case(wanted))
    });
    match wanted.parse::<usize>() {
        Ok(number) if by_name.is_empty() && number < stacks.len() => vec![number],
        _ => by_name,
    }
}

fn is_one_series(stacks: &[Stack], images: &[Image], of: &[usize]) -> bool {
    let uid = |i: usize| &images[stacks[i].planes[0].image].series_uid;
    of.windows(2).all(|pair| uid(pair[0]) == uid(pair[1]))
}
