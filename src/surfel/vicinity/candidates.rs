//! Candidates of a group, in the form that loops over vectors read.

use crate::simd::{LANES, Level};

/// A coordinate that is in no ball.
pub(super) const NOWHERE: f32 = 1e6;

/// Binary digits of tags.
pub(crate) const PLANES: usize = 3;

/// Candidates in the form that loops over vectors read, one array for each of their properties. Padded.
#[derive(Clone, Debug, Default)]
pub(crate) struct Candidates {
    pub(super) len: usize,
    /// Khalimsky coordinates relative to [`Vicinity::origin`].
    pub(crate) x: Vec<f32>,
    /// As `x`, along y.
    pub(crate) y: Vec<f32>,
    /// As `x`, along z.
    pub(crate) z: Vec<f32>,
    /// Their places.
    pub(crate) place: Vec<u32>,
    /// Their tags, of [`PLANES`] binary digits.
    pub(super) tag: Vec<u32>,
    /// Whether some tag is not 0.
    has_tags: bool,
    /// Each digit of the tags, sixteen candidates a number; empty if there is none.
    planes: [Vec<u16>; PLANES],
    /// Label, if they are of a list with labels.
    pub(crate) label: Vec<u32>,
}

impl Candidates {
    /// How many there are with those that fill the arrays up.
    #[must_use]
    pub(crate) fn padded(&self) -> usize {
        self.len.next_multiple_of(LANES)
    }

    pub(super) fn make_room(&mut self, more: usize) {
        let room = self.len + more + LANES;
        if self.x.len() < room {
            let room = room.next_power_of_two();
            for list in [&mut self.x, &mut self.y, &mut self.z] {
                list.resize(room, NOWHERE);
            }
            for list in [&mut self.place, &mut self.tag, &mut self.label] {
                list.resize(room, 0);
            }
        }
    }

    #[inline(always)]
    pub(super) fn set(&mut self, at: usize, k: [f32; 3], place: u32, tag: u32) {
        self.x[at] = k[0];
        self.y[at] = k[1];
        self.z[at] = k[2];
        self.place[at] = place;
        self.tag[at] = tag;
    }

    pub(crate) fn clear(&mut self) {
        self.len = 0;
        self.has_tags = false;
    }

    /// Adds those chosen of sixteen places from `from` on. There must be room for sixteen.
    #[inline(always)]
    pub(super) fn take<L: Level>(
        &mut self,
        k: [L::F; 3],
        from: usize,
        tags: &[u32; LANES],
        chosen: u16,
    ) {
        if chosen == 0 {
            return;
        }
        self.append::<L>(k, &sixteen_from(from), tags, chosen);
    }

    /// Adds those chosen of sixteen candidates. There must be room for sixteen.
    #[inline(always)]
    fn append<L: Level>(
        &mut self,
        k: [L::F; 3],
        places: &[u32; LANES],
        tags: &[u32; LANES],
        chosen: u16,
    ) {
        let mask = L::from_bits(chosen);
        let at = self.len;
        L::compress(k[0], mask, sixteen_mut(&mut self.x, at));
        L::compress(k[1], mask, sixteen_mut(&mut self.y, at));
        L::compress(k[2], mask, sixteen_mut(&mut self.z, at));
        L::compress_u32(places, mask, sixteen_mut(&mut self.place, at));
        L::compress_u32(tags, mask, sixteen_mut(&mut self.tag, at));
        self.has_tags |= L::bits(L::equal(tags, 0)) & chosen != chosen;
        self.len += chosen.count_ones() as usize;
    }

    /// Adds those chosen of sixteen candidates of a list from `at` on, with their labels.
    #[inline(always)]
    pub(super) fn move_from<L: Level>(
        &mut self,
        list: &Self,
        at: usize,
        labels: &[u32; LANES],
        chosen: u16,
    ) {
        if chosen == 0 {
            return;
        }
        self.make_room(LANES);
        let mask = L::from_bits(chosen);
        L::compress_u32(labels, mask, sixteen_mut(&mut self.label, self.len));
        let k = [
            L::load(sixteen(&list.x, at)),
            L::load(sixteen(&list.y, at)),
            L::load(sixteen(&list.z, at)),
        ];
        let (places, tags) = (sixteen(&list.place, at), sixteen(&list.tag, at));
        self.append::<L>(k, places, tags, chosen);
    }

    /// Adds those chosen of its own candidates, sixteen from `at` on, after it was cut to less than `at`: what
    /// follows is overwritten.
    #[inline(always)]
    pub(super) fn keep<L: Level>(&mut self, at: usize, chosen: u16) {
        let k = [
            L::load(sixteen(&self.x, at)),
            L::load(sixteen(&self.y, at)),
            L::load(sixteen(&self.z, at)),
        ];
        let (places, tags) = (*sixteen(&self.place, at), *sixteen(&self.tag, at));
        self.append::<L>(k, &places, &tags, chosen);
    }

    pub(crate) fn push(&mut self, k: [f32; 3], place: u32, tag: u32) {
        self.make_room(1);
        self.set(self.len, k, place, tag);
        self.has_tags |= tag != 0;
        self.len += 1;
    }

    pub(crate) fn pad(&mut self) {
        self.make_room(0);
        for at in self.len..self.padded() {
            self.set(at, [NOWHERE; 3], 0, 0);
            self.label[at] = 0;
        }
        for (digit, plane) in self.planes.iter_mut().enumerate() {
            plane.clear();
            if self.has_tags {
                let tags = self.tag[..self.len.next_multiple_of(LANES)]
                    .as_chunks::<LANES>()
                    .0;
                plane.extend(tags.iter().map(|tags| {
                    let digits = tags.iter().enumerate();
                    digits.fold(0, |bits, (i, tag)| bits | ((tag >> digit & 1) as u16) << i)
                }));
            }
        }
    }

    /// Which of sixteen candidates have each digit in their tags, by digit.
    #[inline(always)]
    pub(crate) fn tagged(&self, sixteen: usize) -> Option<[u16; PLANES]> {
        if !self.has_tags {
            return None;
        }
        Some([
            self.planes[0][sixteen],
            self.planes[1][sixteen],
            self.planes[2][sixteen],
        ])
    }

    #[cfg(test)]
    pub(super) fn k(&self, at: usize) -> [f32; 3] {
        [self.x[at], self.y[at], self.z[at]]
    }
}

/// Sixteen numbers from one on.
#[inline(always)]
pub(super) fn sixteen_from(first: usize) -> [u32; LANES] {
    let mut numbers = [0; LANES];
    for i in 0..LANES {
        numbers[i] = first as u32 + i as u32;
    }
    numbers
}

/// Sixteen numbers of a list.
#[inline(always)]
pub(super) fn sixteen<T>(list: &[T], from: usize) -> &[T; LANES] {
    list[from..]
        .first_chunk()
        .expect("lists have sixteen more than they need")
}

#[inline(always)]
pub(super) fn sixteen_mut<T>(list: &mut [T], from: usize) -> &mut [T; LANES] {
    list[from..]
        .first_chunk_mut()
        .expect("lists have sixteen more than they need")
}
