//! JPEG-LS (ITU-T T.87): one component of 2 to 16 bits, lossless or near-lossless.
//!
//! No maintained decoder in Rust without C exists outside of whole DICOM toolkits, so this is
//! our own, written from the recommendation; the names of variables are its own (annex A).
//!
//! Refused: several components, mapping tables, extents given by an LSE segment.

use super::{CodecResult, Extents, ends_early, reserve};

/// Orders of run lengths by run index (A.7.1).
const J: [u32; 32] = [
    0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 9, 10, 11, 12, 13,
    14, 15,
];

/// Contexts of the regular mode; two more serve run interruptions.
const REGULAR: usize = 365;

/// Coding parameters (annex C); zero stands for the default.
#[derive(Clone, Copy, Debug, Default)]
struct Preset {
    maxval: i32,
    t1: i32,
    t2: i32,
    t3: i32,
    reset: i32,
}

/// Replaces `out` by the samples of `data`, and gives their precision in bits.
pub(in crate::dicom) fn decode(
    data: &[u8],
    extents: Extents,
    out: &mut Vec<u16>,
) -> CodecResult<u8> {
    if !data.starts_with(&[0xff, 0xd8]) {
        return Err("not JPEG-LS data: it does not begin with FF D8".into());
    }
    let early = || "the JPEG-LS header ends early".to_string();
    let mut preset = Preset::default();
    let mut precision = None;
    let mut restart = 0_usize;
    let mut at = 2;
    loop {
        let &[0xff, marker] = data.get(at..at + 2).ok_or_else(early)? else {
            return Err(format!("no JPEG-LS marker at byte {at} of the frame"));
        };
        if marker == 0xff {
            at += 1;
            continue;
        }
        let length = usize::from(be16(data, at + 2).ok_or_else(early)?);
        let segment = data.get(at + 4..at + 2 + length).ok_or_else(early)?;
        at += 2 + length;
        match marker {
            0xf7 => precision = Some(read_frame(segment, extents)?),
            0xf8 => read_preset(segment, &mut preset)?,
            0xdd => restart = read_restart(segment)?,
            0xda => {
                let precision = precision.ok_or("the JPEG-LS scan has no frame header")?;
                let &[1, _, mapping, near, interleave, shift, ..] = segment else {
                    return Err("the JPEG-LS scan is not of one component".into());
                };
                if mapping != 0 {
                    return Err("a JPEG-LS mapping table is not read".into());
                }
                if shift & 15 != 0 {
                    return Err("a JPEG-LS point transform is not read".into());
                }
                // One component is never interleaved, but some writers say so.
                if interleave > 2 {
                    return Err(format!("JPEG-LS has no interleave mode {interleave}"));
                }
                let rest = data.get(at..).unwrap_or_default();
                let mut scan = Scan::new(precision, near.into(), preset, rest)?;
                scan.decode(extents, restart, out)?;
                return Ok(precision);
            }
            0xd9 => return Err("the JPEG-LS data ends before its scan".into()),
            0xc0..=0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => {
                return Err("JPEG data where JPEG-LS is expected".into());
            }
            _ => {}
        }
    }
}

fn be16(data: &[u8], at: usize) -> Option<u16> {
    let bytes = data.get(at..at + 2)?.try_into().ok()?;
    Some(u16::from_be_bytes(bytes))
}

fn read_frame(segment: &[u8], extents: Extents) -> CodecResult<u8> {
    let early = || "the JPEG-LS frame header ends early".to_string();
    let &[precision, _, _, _, _, components, ..] = segment else {
        return Err(early());
    };
    if components != 1 {
        return Err(format!(
            "the compressed image has {components} components, 1 expected"
        ));
    }
    if !(2..=16).contains(&precision) {
        return Err(format!(
            "a JPEG-LS precision of {precision} bits is not read"
        ));
    }
    let rows = be16(segment, 1).ok_or_else(early)?;
    let columns = be16(segment, 3).ok_or_else(early)?;
    extents.check(columns.into(), rows.into())?;
    Ok(precision)
}

fn read_preset(segment: &[u8], preset: &mut Preset) -> CodecResult<()> {
    match segment.first() {
        Some(1) => {
            let word = |i: usize| {
                be16(segment, 1 + 2 * i)
                    .map(i32::from)
                    .ok_or("the JPEG-LS coding parameters end early")
            };
            *preset = Preset {
                maxval: word(0)?,
                t1: word(1)?,
                t2: word(2)?,
                t3: word(3)?,
                reset: word(4)?,
            };
            Ok(())
        }
        Some(kind) => Err(format!("JPEG-LS preset of type {kind} is not read")),
        None => Err("an empty JPEG-LS preset".into()),
    }
}

fn read_restart(segment: &[u8]) -> CodecResult<usize> {
    if segment.len() > 4 {
        return Err("a JPEG-LS restart interval of more than four bytes".into());
    }
    Ok(segment
        .iter()
        .fold(0, |all, &byte| (all << 8) | usize::from(byte)))
}

/// Bits of a scan: after a byte FF the next byte has only seven (A.1).
struct Bits<'a> {
    data: &'a [u8],
    at: usize,
    held: u64,
    count: u32,
    after_ff: bool,
}

impl Bits<'_> {
    fn fill(&mut self) {
        while self.count <= 48 {
            let Some(&byte) = self.data.get(self.at) else {
                return;
            };
            if self.after_ff && byte >= 0x80 {
                // A marker: its FF was padding.
                return;
            }
            if byte == 0xff && self.data.get(self.at + 1).is_none_or(|&next| next >= 0x80) {
                return;
            }
            let width = if self.after_ff { 7 } else { 8 };
            self.held = (self.held << width) | u64::from(byte);
            self.count += width;
            self.after_ff = byte == 0xff;
            self.at += 1;
        }
    }

    fn take(&mut self, count: u32) -> Option<u32> {
        if self.count < count {
            self.fill();
        }
        self.count = self.count.checked_sub(count)?;
        Some((self.held >> self.count) as u32 & ((1_u32 << count) - 1))
    }

    /// Zeros before the next one, of which there may be at most `most`.
    fn zeros(&mut self, most: u32) -> Option<u32> {
        let mut zeros = 0;
        loop {
            if self.count == 0 {
                self.fill();
                if self.count == 0 {
                    return None;
                }
            }
            let word = self.held << (64 - self.count);
            let leading = word.leading_zeros().min(self.count);
            zeros += leading;
            if zeros > most {
                return None;
            }
            if leading < self.count {
                self.count -= leading + 1;
                return Some(zeros);
            }
            self.count = 0;
        }
    }

    /// Goes behind the restart marker that must come next.
    fn restart(&mut self) -> CodecResult<()> {
        // A last byte FF is followed by a byte of seven padding bits, unless the marker is it.
        self.held = 0;
        self.count = 0;
        self.after_ff = false;
        let rest = self.data.get(self.at..).unwrap_or_default();
        let skip = rest
            .windows(2)
            .take(4)
            .position(|pair| pair[0] == 0xff && (0xd0..=0xd7).contains(&pair[1]))
            .ok_or("a JPEG-LS restart marker is missing")?;
        self.at += skip + 2;
        Ok(())
    }
}

/// Statistics of a context (A.2.1, A.8).
#[derive(Clone, Copy, Debug)]
struct Context {
    a: i32,
    b: i32,
    c: i32,
    n: i32,
}

/// A scan being decoded.
struct Scan<'a> {
    bits: Bits<'a>,
    near: i32,
    maxval: i32,
    range: i32,
    qbpp: u32,
    limit: u32,
    t: [i32; 3],
    reset: i32,
    contexts: [Context; REGULAR],
    /// Of run interruptions: `b` counts negative errors (`Nn`).
    interruptions: [Context; 2],
    run_index: usize,
}

/// CLAMP of C.2.4.1.1.1: values outside of the bounds become the lower one.
fn clamp_to(value: i32, least: i32, most: i32) -> i32 {
    if value > most || value < least {
        least
    } else {
        value
    }
}

/// Bits that values below `values` need.
fn bits_for(values: i32) -> u32 {
    32 - (values - 1).leading_zeros()
}

impl<'a> Scan<'a> {
    fn new(precision: u8, near: i32, preset: Preset, data: &'a [u8]) -> CodecResult<Self> {
        let or = |value: i32, default: i32| if value == 0 { default } else { value };
        let most = (1_i32 << precision) - 1;
        let maxval = or(preset.maxval, most);
        if maxval > most || near > 255.min(maxval / 2) {
            return Err(format!(
                "JPEG-LS parameters contradict each other: MAXVAL {maxval}, NEAR {near}, \
                 {precision} bits"
            ));
        }
        let [t1, t2, t3] = default_thresholds(maxval, near);
        let t = [or(preset.t1, t1), or(preset.t2, t2), or(preset.t3, t3)];
        let reset = or(preset.reset, 64);
        if !(near < t[0] && t[0] <= t[1] && t[1] <= t[2] && t[2] <= maxval) || reset < 3 {
            return Err(format!(
                "JPEG-LS thresholds {t:?} or reset {reset} are not within bounds"
            ));
        }
        let range = (maxval + 2 * near) / (2 * near + 1) + 1;
        let bpp = bits_for(maxval + 1).max(2);
        let context = Context {
            a: ((range + 32) / 64).max(2),
            b: 0,
            c: 0,
            n: 1,
        };
        Ok(Self {
            bits: Bits {
                data,
                at: 0,
                held: 0,
                count: 0,
                after_ff: false,
            },
            near,
            maxval,
            range,
            qbpp: bits_for(range),
            limit: 2 * (bpp + bpp.max(8)),
            t,
            reset,
            contexts: [context; REGULAR],
            interruptions: [context; 2],
            run_index: 0,
        })
    }

    fn decode(&mut self, extents: Extents, restart: usize, out: &mut Vec<u16>) -> CodecResult<()> {
        let Extents { columns, rows } = extents;
        reserve(out, extents.samples())?;
        let fresh = (self.contexts, self.interruptions);
        // One sample more on either side: c of the first and d of the last column.
        let mut above = vec![0_i32; columns + 2];
        let mut line = vec![0_i32; columns + 2];
        for row in 0..rows {
            if restart > 0 && row > 0 && row % restart == 0 {
                self.bits.restart()?;
                (self.contexts, self.interruptions) = fresh;
                self.run_index = 0;
                above.fill(0);
                line.fill(0);
            }
            above[columns + 1] = above[columns];
            line[0] = above[1];
            self.decode_line(&above, &mut line)
                .ok_or_else(|| ends_early(row * columns, extents.samples()))?;
            out.extend(line[1..=columns].iter().map(|&sample| sample as u16));
            std::mem::swap(&mut above, &mut line);
        }
        Ok(())
    }

    /// Decodes a line; `None` where the data ends or is damaged.
    fn decode_line(&mut self, above: &[i32], line: &mut [i32]) -> Option<()> {
        let width = line.len() - 2;
        let mut x = 1;
        while x <= width {
            let (ra, rb, rc, rd) = (line[x - 1], above[x], above[x - 1], above[x + 1]);
            let q = [rd - rb, rb - rc, rc - ra].map(|d| self.quantize(d));
            if q == [0; 3] {
                x = self.decode_run(above, line, x)?;
            } else {
                line[x] = self.decode_regular(q, ra, rb, rc)?;
                x += 1;
            }
        }
        Some(())
    }

    fn quantize(&self, d: i32) -> i32 {
        let level = match d.abs() {
            d if d <= self.near => 0,
            d if d < self.t[0] => 1,
            d if d < self.t[1] => 2,
            d if d < self.t[2] => 3,
            _ => 4,
        };
        if d < 0 { -level } else { level }
    }

    fn decode_regular(&mut self, q: [i32; 3], ra: i32, rb: i32, rc: i32) -> Option<i32> {
        let number = (q[0] * 9 + q[1]) * 9 + q[2];
        let sign = if number < 0 { -1 } else { 1 };
        let index = usize::try_from(number.abs()).ok()?;
        let context = *self.contexts.get(index)?;
        let predicted = if rc >= ra.max(rb) {
            ra.min(rb)
        } else if rc <= ra.min(rb) {
            ra.max(rb)
        } else {
            ra + rb - rc
        };
        let predicted = (predicted + sign * context.c).clamp(0, self.maxval);
        let k = golomb_order(context.n, context.a);
        let mapped = self.golomb(k, self.limit)?;
        let swapped = self.near == 0 && k == 0 && 2 * context.b <= -context.n;
        let error = match (swapped, mapped & 1 == 1) {
            (false, false) => mapped / 2,
            (false, true) => -(mapped + 1) / 2,
            (true, true) => mapped / 2,
            (true, false) => -(mapped / 2) - 1,
        };
        self.update(index, error);
        Some(self.reconstruct(predicted, sign * error))
    }

    /// Updates a regular context (A.6).
    fn update(&mut self, index: usize, error: i32) {
        let reset = self.reset;
        let scale = 2 * self.near + 1;
        let Some(context) = self.contexts.get_mut(index) else {
            return;
        };
        context.b += error * scale;
        context.a += error.abs();
        if context.n == reset {
            context.a >>= 1;
            context.b >>= 1;
            context.n >>= 1;
        }
        context.n += 1;
        if context.b <= -context.n {
            context.b = (context.b + context.n).max(1 - context.n);
            context.c = (context.c - 1).max(-128);
        } else if context.b > 0 {
            context.b = (context.b - context.n).min(0);
            context.c = (context.c + 1).min(127);
        }
    }

    /// The sample from its prediction and error, modulo the range (A.4.4, A.5.3).
    fn reconstruct(&self, predicted: i32, error: i32) -> i32 {
        let scale = 2 * self.near + 1;
        let mut sample = predicted + error * scale;
        if sample < -self.near {
            sample += self.range * scale;
        } else if sample > self.maxval + self.near {
            sample -= self.range * scale;
        }
        sample.clamp(0, self.maxval)
    }

    /// A limited-length Golomb code (A.5.3).
    fn golomb(&mut self, k: u32, limit: u32) -> Option<i32> {
        // At least one: run orders stay below the limit for every precision.
        let escape = limit.checked_sub(self.qbpp + 1)?;
        let zeros = self.bits.zeros(escape)?;
        let value = if zeros < escape {
            (zeros << k) | self.bits.take(k)?
        } else {
            self.bits.take(self.qbpp)? + 1
        };
        // Errors of damaged data would grow without bounds in the statistics.
        i32::try_from(value)
            .ok()
            .filter(|&value| value <= 2 * self.range)
    }

    /// Decodes a run and the sample that ends it, and gives the column behind (A.7).
    fn decode_run(&mut self, above: &[i32], line: &mut [i32], mut x: usize) -> Option<usize> {
        let width = line.len() - 2;
        let ra = line[x - 1];
        loop {
            let order = J[self.run_index];
            if self.bits.take(1)? == 1 {
                let whole = 1_usize << order;
                let count = whole.min(width + 1 - x);
                line[x..x + count].fill(ra);
                x += count;
                if count == whole {
                    self.run_index = (self.run_index + 1).min(J.len() - 1);
                }
                if x > width {
                    return Some(x);
                }
            } else {
                let count = self.bits.take(order)? as usize;
                if x + count > width {
                    return None;
                }
                line[x..x + count].fill(ra);
                x += count;
                break;
            }
        }
        let rb = above[x];
        line[x] = self.decode_interruption(ra, rb)?;
        self.run_index = self.run_index.saturating_sub(1);
        Some(x + 1)
    }

    /// The sample that ends a run (A.7.2).
    fn decode_interruption(&mut self, ra: i32, rb: i32) -> Option<i32> {
        let same = (ra - rb).abs() <= self.near;
        let kind = i32::from(same);
        let context = self.interruptions[usize::from(same)];
        let total = if same {
            context.a + (context.n >> 1)
        } else {
            context.a
        };
        let k = golomb_order(context.n, total);
        let limit = self.limit.checked_sub(J[self.run_index] + 1)?;
        let mapped = self.golomb(k, limit)?;
        let folded = mapped + kind;
        let odd = folded & 1;
        let magnitude = (folded + odd) / 2;
        let negative = (k != 0 || 2 * context.b >= context.n) == (odd == 1);
        let error = if negative { -magnitude } else { magnitude };

        let reset = self.reset;
        let context = &mut self.interruptions[usize::from(same)];
        if error < 0 {
            context.b += 1;
        }
        context.a += (mapped + 1 - kind) >> 1;
        if context.n == reset {
            context.a >>= 1;
            context.n >>= 1;
            context.b >>= 1;
        }
        context.n += 1;
        Some(if same {
            self.reconstruct(ra, error)
        } else {
            let sign = if ra > rb { -1 } else { 1 };
            self.reconstruct(rb, sign * error)
        })
    }
}

/// The least k with `n << k >= a`.
fn golomb_order(n: i32, a: i32) -> u32 {
    let mut k = 0;
    while k < 24 && n << k < a {
        k += 1;
    }
    k
}

/// T1, T2 and T3 where the file gives none (C.2.4.1.1.1).
fn default_thresholds(maxval: i32, near: i32) -> [i32; 3] {
    let (basic, t1, t2);
    if maxval >= 128 {
        let factor = (maxval.min(4095) + 128) / 256;
        basic = [factor + 2, 4 * factor + 3, 17 * factor + 4];
    } else {
        let factor = 256 / (maxval + 1);
        basic = [
            (3 / factor).max(2),
            (7 / factor).max(3),
            (21 / factor).max(4),
        ];
    }
    t1 = clamp_to(basic[0] + 3 * near, near + 1, maxval);
    t2 = clamp_to(basic[1] + 5 * near, t1, maxval);
    [t1, t2, clamp_to(basic[2] + 7 * near, t2, maxval)]
}
