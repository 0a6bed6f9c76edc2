//! Every level against the portable one, bit by bit.

use super::{LANES, Level, Portable, Work, rounded};

/// Everything a level can do, on some numbers.
struct Everything<'a> {
    x: &'a [f32; LANES],
    y: &'a [f32; LANES],
    bytes: &'a [i8; LANES],
    shorts: &'a [i16; LANES],
    names: &'a [u32; LANES],
    table: &'a [u32],
}

impl Work for Everything<'_> {
    type Output = Vec<u64>;

    #[inline(always)]
    fn run<L: Level>(self) -> Vec<u64> {
        let mut found = Vec::new();
        let (x, y) = (L::load(self.x), L::load(self.y));
        let numbers = [
            L::all(self.x[3]),
            L::load_i16(self.shorts),
            L::load_i8(self.bytes),
            L::add(x, y),
            L::sub(x, y),
            L::mul(x, y),
            L::min(x, y),
            L::max(x, y),
            rounded::<L>(x),
        ];
        let every = L::mask(true);
        for number in numbers {
            let mut to = [0.0; LANES];
            L::store_chosen(number, every, &mut to);
            found.extend(to.map(f64::to_bits));
            L::store(number, &mut to);
            found.extend(to.map(f64::to_bits));
        }
        let chosen = L::at_most(x, y);
        let bits = L::bits(chosen);
        found.push(u64::from(bits));
        found.push(u64::from(L::bits(L::from_bits(bits ^ 0x5a5a))));
        found.push(u64::from(L::bits(L::and(chosen, L::from_bits(0x0ff0)))));
        found.push(u64::from(L::bits(L::mask(false))));
        found.push(u64::from(L::bits(L::equal(self.names, self.names[5]))));
        found.push(u64::from(L::bits(L::looked_up(self.names, self.table))));
        let mut to = [0.0; LANES];
        L::store_chosen(x, chosen, &mut to);
        found.extend(to.map(f64::to_bits));
        let kept = bits.count_ones() as usize;
        let mut to = [0.0; LANES];
        L::compress(x, chosen, &mut to);
        found.extend(to[..kept].iter().map(|x| u64::from(x.to_bits())));
        let mut to = [0; LANES];
        L::compress_u32(self.names, chosen, &mut to);
        found.extend(to[..kept].iter().map(|&x| u64::from(x)));
        let counts = L::load_i16(&self.shorts.map(|x| x & 0x7fff));
        let sums = L::add_chosen(L::add_chosen(L::zero(), counts, chosen), counts, every);
        found.push(L::total(sums));
        let short = L::load_i16(self.shorts);
        let squares = L::weighted_square(&[3.0, 1048576.0, 17.0], [short; 3]);
        found.push(u64::from(L::bits(L::at_most_double(squares, 1e14))));
        found.push(L::sum_chosen(squares, chosen).to_bits());
        let mut to = [0.0; LANES];
        L::store_chosen(L::scaled(squares, 1.0 / 3.0), every, &mut to);
        found.extend(to.map(f64::to_bits));
        found.push(L::multiply_add(3.0, f64::from(self.shorts[0]), 0.5).to_bits());
        found
    }
}

#[test]
fn levels_give_the_same_bits() {
    let mut seed = 7u64;
    let mut random = || {
        seed = seed
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        seed >> 33
    };
    for _ in 0..500 {
        let mut number = || (random() as i32 % 4096) as f32 / 8.0 - 100.0;
        let x: [f32; LANES] = std::array::from_fn(|_| number());
        let mut y: [f32; LANES] = std::array::from_fn(|_| number());
        y[2] = x[2];
        let bytes = std::array::from_fn(|_| random() as i8);
        let shorts = std::array::from_fn(|_| random() as i16);
        let names = std::array::from_fn(|_| random() as u32 % 7);
        let table: Vec<u32> = (0..7).map(|_| random() as u32 & 1).collect();
        let everything = || Everything {
            x: &x,
            y: &y,
            bytes: &bytes,
            shorts: &shorts,
            names: &names,
            table: &table,
        };
        let expected = everything().run::<Portable>();
        for found in super::at_every_level(everything) {
            assert_eq!(found, expected);
        }
    }
}
