//! JPEG (ITU-T T.81): one component, Huffman coded, lossless or sequential DCT.
//!
//! Marker segments, Huffman tables and the bit reader live here, with the lossless process
//! (annex H: predictors 1 to 7, point transform, restart intervals, 2 to 16 bits); the DCT
//! processes (8 and 12 bits) are in `dct`. Of the JPEG crates none decodes 12-bit DCT, and the
//! only one with the lossless process is no longer developed; both processes share the Huffman
//! decoder, so one small decoder serves them all.
//!
//! Refused: arithmetic coding, progressive and hierarchical processes, several components.

use super::{CodecResult, Extents, dct, ends_early, reserve};

/// What SOF says.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) precision: u8,
    lossless: bool,
    quantization: u8,
}

/// What SOS says.
#[derive(Clone, Copy, Debug)]
struct Scan {
    dc_table: u8,
    ac_table: u8,
    /// Predictor of the lossless process.
    start: u8,
    /// Point transform: samples were shifted right by this.
    shift: u8,
}

/// Replaces `out` by the samples of `data`, and gives their precision in bits.
pub(in crate::dicom) fn decode(
    data: &[u8],
    extents: Extents,
    out: &mut Vec<u16>,
) -> CodecResult<u8> {
    let mut dc: [Option<Huffman>; 4] = [None, None, None, None];
    let mut ac: [Option<Huffman>; 4] = [None, None, None, None];
    let mut quantization = [None; 4];
    let mut frame: Option<Frame> = None;
    let mut restart = 0_usize;
    let mut markers = Markers::new(data)?;
    loop {
        let (marker, segment) = markers.next()?;
        match marker {
            0xc4 => read_huffman(segment, &mut dc, &mut ac)?,
            0xdb => dct::read_quantization(segment, &mut quantization)?,
            0xdd => restart = usize::from(be16(segment, 0)?),
            0xc0 | 0xc1 | 0xc3 => {
                if frame.is_some() {
                    return Err("two JPEG frame headers".into());
                }
                frame = Some(read_frame(segment, marker == 0xc3, extents)?);
            }
            0xc2 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => {
                return Err(format!(
                    "JPEG process {} is not read (only sequential Huffman coding and lossless)",
                    marker - 0xc0
                ));
            }
            0xda => {
                let frame = frame.ok_or("the JPEG scan has no frame header before it")?;
                let scan = read_scan(segment)?;
                let missing = |kind: &str, table: u8| format!("{kind} table {table} is missing");
                let dc = dc
                    .get(usize::from(scan.dc_table))
                    .and_then(Option::as_ref)
                    .ok_or_else(|| missing("Huffman", scan.dc_table))?;
                let mut bits = Bits::new(markers.rest());
                if frame.lossless {
                    lossless(&mut bits, dc, &frame, &scan, restart, extents, out)?;
                } else {
                    let ac = ac
                        .get(usize::from(scan.ac_table))
                        .and_then(Option::as_ref)
                        .ok_or_else(|| missing("Huffman", scan.ac_table))?;
                    let steps = quantization
                        .get(usize::from(frame.quantization))
                        .and_then(Option::as_ref)
                        .ok_or_else(|| missing("quantization", frame.quantization))?;
                    dct::decode(
                        &mut bits,
                        dc,
                        ac,
                        steps,
                        frame.precision,
                        restart,
                        extents,
                        out,
                    )?;
                }
                return Ok(frame.precision);
            }
            0xd9 => return Err("the JPEG data ends before its scan".into()),
            _ => {}
        }
    }
}

/// Marker segments up to the scan.
struct Markers<'a> {
    data: &'a [u8],
    at: usize,
}

impl<'a> Markers<'a> {
    fn new(data: &'a [u8]) -> CodecResult<Self> {
        if !data.starts_with(&[0xff, 0xd8]) {
            return Err("not JPEG data: it does not begin with FF D8".into());
        }
        Ok(Self { data, at: 2 })
    }

    /// The next marker and its segment.
    fn next(&mut self) -> CodecResult<(u8, &'a [u8])> {
        let early = || "the JPEG header ends early".to_string();
        loop {
            // Fill bytes FF may come before a marker.
            if *self.data.get(self.at).ok_or_else(early)? != 0xff {
                return Err(format!("no JPEG marker at byte {} of the frame", self.at));
            }
            let marker = *self.data.get(self.at + 1).ok_or_else(early)?;
            self.at += 1;
            if marker == 0xff {
                continue;
            }
            self.at += 1;
            // Markers without a segment.
            if matches!(marker, 0x01 | 0xd0..=0xd9) {
                return Ok((marker, &[]));
            }
            let length = usize::from(be16(self.data, self.at)?);
            let segment = self
                .data
                .get(self.at + 2..self.at + length)
                .ok_or_else(early)?;
            self.at += length;
            return Ok((marker, segment));
        }
    }

    fn rest(&self) -> &'a [u8] {
        self.data.get(self.at..).unwrap_or_default()
    }
}

pub(super) fn be16(data: &[u8], at: usize) -> CodecResult<u16> {
    data.get(at..at + 2)
        .and_then(|b| b.try_into().ok())
        .map(u16::from_be_bytes)
        .ok_or_else(|| "a marker segment ends early".into())
}

fn read_frame(segment: &[u8], lossless: bool, extents: Extents) -> CodecResult<Frame> {
    let &[precision, _, _, _, _, components, ..] = segment else {
        return Err("the JPEG frame header ends early".into());
    };
    if components != 1 {
        return Err(format!(
            "the compressed image has {components} components, 1 expected"
        ));
    }
    let known = if lossless {
        (2..=16).contains(&precision)
    } else {
        matches!(precision, 8 | 12)
    };
    if !known {
        return Err(format!("a JPEG precision of {precision} bits is not read"));
    }
    extents.check(be16(segment, 3)?.into(), be16(segment, 1)?.into())?;
    let quantization = *segment.get(8).ok_or("the JPEG frame header ends early")?;
    Ok(Frame {
        precision,
        lossless,
        quantization,
    })
}

fn read_scan(segment: &[u8]) -> CodecResult<Scan> {
    let &[1, _, tables, start, _, approximation, ..] = segment else {
        return Err("the JPEG scan is not of one component".into());
    };
    Ok(Scan {
        dc_table: tables >> 4,
        ac_table: tables & 15,
        start,
        shift: approximation & 15,
    })
}

/// A Huffman table: a lookup by eight bits, and the canonical code for longer words.
pub(super) struct Huffman {
    /// Length and value by the first eight bits; length 0 for longer words.
    short: [(u8, u8); 256],
    /// By length: first code, one behind the last code, index of the first value.
    long: [(u32, u32, usize); 17],
    values: Vec<u8>,
}

impl Huffman {
    fn new(counts: &[u8], values: &[u8]) -> CodecResult<Self> {
        let mut table = Self {
            short: [(0, 0); 256],
            long: [(0, 0, 0); 17],
            values: values.to_vec(),
        };
        let (mut code, mut index) = (0_u32, 0_usize);
        for (length, &count) in (1_u32..).zip(counts) {
            let end = code + u32::from(count);
            if end > 1 << length {
                return Err("a Huffman table has more words than bits can tell".into());
            }
            table.long[length as usize] = (code, end, index);
            if length <= 8 {
                for (word, &value) in (code..end).zip(values.iter().skip(index)) {
                    let first = (word << (8 - length)) as usize;
                    let span = 1 << (8 - length);
                    table.short[first..first + span].fill((length as u8, value));
                }
            }
            index += usize::from(count);
            code = end << 1;
        }
        Ok(table)
    }

    /// The next value; `None` where the data ends or has no such word.
    pub(super) fn next(&self, bits: &mut Bits<'_>) -> Option<u8> {
        let word = bits.peek16();
        let (length, value) = self.short[(word >> 8) as usize];
        if length > 0 {
            bits.drop(length.into())?;
            return Some(value);
        }
        for length in 9..=16 {
            let code = word >> (16 - length);
            let (first, end, index) = self.long[length as usize];
            if code < end && code >= first {
                bits.drop(length)?;
                return self.values.get(index + (code - first) as usize).copied();
            }
        }
        None
    }
}

fn read_huffman(
    mut segment: &[u8],
    dc: &mut [Option<Huffman>; 4],
    ac: &mut [Option<Huffman>; 4],
) -> CodecResult<()> {
    let early = || "a Huffman table ends early".to_string();
    while let Some((&kind, rest)) = segment.split_first() {
        let counts = rest.get(..16).ok_or_else(early)?;
        let total: usize = counts.iter().map(|&n| usize::from(n)).sum();
        let values = rest.get(16..16 + total).ok_or_else(early)?;
        segment = rest.get(16 + total..).ok_or_else(early)?;
        let tables = if kind >> 4 == 0 { &mut *dc } else { &mut *ac };
        *tables
            .get_mut(usize::from(kind & 15))
            .ok_or("a Huffman table has a number above 3")? = Some(Huffman::new(counts, values)?);
    }
    Ok(())
}

/// The bits of a scan, stuffed zeros removed, up to the next marker.
pub(super) struct Bits<'a> {
    data: &'a [u8],
    at: usize,
    held: u64,
    count: u32,
}

impl<'a> Bits<'a> {
    fn new(data: &'a [u8]) -> Self {
        Self {
            data,
            at: 0,
            held: 0,
            count: 0,
        }
    }

    fn fill(&mut self) {
        while self.count <= 48 {
            let Some(&byte) = self.data.get(self.at) else {
                return;
            };
            if byte == 0xff {
                if self.data.get(self.at + 1) != Some(&0) {
                    return;
                }
                self.at += 1;
            }
            self.at += 1;
            self.held = (self.held << 8) | u64::from(byte);
            self.count += 8;
        }
    }

    /// The next 16 bits, zeros where the data ends.
    fn peek16(&mut self) -> u32 {
        if self.count < 16 {
            self.fill();
        }
        let word = if self.count >= 16 {
            self.held >> (self.count - 16)
        } else {
            self.held << (16 - self.count)
        };
        (word & 0xffff) as u32
    }

    /// Takes bits that were looked at; `None` if there are not so many.
    fn drop(&mut self, count: u32) -> Option<()> {
        self.count = self.count.checked_sub(count)?;
        Some(())
    }

    /// The difference of category `size` (T.81, tables F.1 and H.2): `size` bits, negative if
    /// the first is 0.
    pub(super) fn difference(&mut self, size: u8) -> Option<i32> {
        if size == 0 {
            return Some(0);
        }
        let size = u32::from(size.min(15));
        let word = (self.peek16() >> (16 - size)).cast_signed();
        self.drop(size)?;
        Some(if word < 1 << (size - 1) {
            word - (1 << size) + 1
        } else {
            word
        })
    }

    /// Goes behind the restart marker that must come next.
    pub(super) fn restart(&mut self) -> CodecResult<()> {
        self.held = 0;
        self.count = 0;
        // Padding between scan bytes and marker is not allowed, fill bytes FF are.
        while self.data.get(self.at..self.at + 2) == Some(&[0xff, 0xff]) {
            self.at += 1;
        }
        match self.data.get(self.at..self.at + 2) {
            Some(&[0xff, 0xd0..=0xd7]) => {
                self.at += 2;
                Ok(())
            }
            _ => Err("a JPEG restart marker is missing".into()),
        }
    }
}

/// Decodes a lossless scan (T.81, annex H).
fn lossless(
    bits: &mut Bits<'_>,
    table: &Huffman,
    frame: &Frame,
    scan: &Scan,
    restart: usize,
    extents: Extents,
    out: &mut Vec<u16>,
) -> CodecResult<()> {
    if !(1..=7).contains(&scan.start) {
        return Err(format!("lossless JPEG has no predictor {}", scan.start));
    }
    if scan.shift >= frame.precision {
        return Err(format!(
            "a point transform of {} bits leaves nothing of {} bits",
            scan.shift, frame.precision
        ));
    }
    let width = extents.columns;
    let expected = extents.samples();
    reserve(out, expected)?;
    let first = 1_i32 << (frame.precision - scan.shift - 1);
    // Samples at which prediction begins anew, as on the first line.
    let mut fresh_from = 0;
    for at in 0..expected {
        if restart > 0 && at > 0 && at % restart == 0 {
            bits.restart()?;
            fresh_from = at;
        }
        let column = at % width;
        let before = |distance: usize| i32::from(out[at - distance]);
        let predicted = if at == fresh_from {
            first
        } else if at - fresh_from < width && at - column <= fresh_from {
            before(1)
        } else if column == 0 {
            before(width)
        } else {
            let (a, b, c) = (before(1), before(width), before(width + 1));
            match scan.start {
                1 => a,
                2 => b,
                3 => c,
                4 => a + b - c,
                5 => a + ((b - c) >> 1),
                6 => b + ((a - c) >> 1),
                _ => (a + b) >> 1,
            }
        };
        let difference = match table.next(bits) {
            Some(16) => 32768,
            Some(size @ 0..=15) => bits
                .difference(size)
                .ok_or_else(|| ends_early(at, expected))?,
            _ => return Err(ends_early(at, expected)),
        };
        // Modulo 2^16 (H.1.2.1).
        out.push((predicted + difference) as u16);
    }
    if scan.shift > 0 {
        for sample in out.iter_mut() {
            *sample <<= scan.shift;
        }
    }
    Ok(())
}
