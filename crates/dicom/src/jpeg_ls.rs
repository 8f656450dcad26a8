//! Decoder of lossless JPEG-LS with one grey value per pixel (ITU-T T.87 A, F).

use crate::segments::segments;

/// Order of the run lengths (T.87 A.2.1, variable J).
const RUN_ORDER: [u32; 32] = [
    0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 9, 10, 11, 12, 13,
    14, 15,
];

/// Decode a stream of a given size and depth; `None` for any other stream, also for one with a loss.
///
/// The coded data must end with the last pixel: less than a byte of zero bits is left.
pub fn decode_jpeg_ls(stream: &[u8], rows: usize, columns: usize, bits: u32) -> Option<Vec<u16>> {
    // A byte below 80 after FF belongs to the data.
    let found = segments(stream, 0xf7, |after| after >= 0x80)?;
    if (found.rows, found.columns, found.bits) != (rows, columns, bits) || !(2..=16).contains(&bits)
    {
        return None;
    }
    // The scan header states the mapping table, the largest loss, the interleaving and the point transform.
    if found.scan != [0, 0, 0, 0] {
        return None;
    }
    let mut decoder = Decoder::new(bits, found.preset, found.data)?;
    // Each row has one value before it and one behind it.
    let width = columns + 2;
    let mut above = vec![0i32; width];
    let mut row = vec![0i32; width];
    let mut values = Vec::with_capacity(rows * columns);
    for _ in 0..rows {
        above[width - 1] = above[width - 2];
        row[0] = above[1];
        decoder.row(&above, &mut row)?;
        values.extend(row[1..=columns].iter().map(|value| *value as u16));
        std::mem::swap(&mut above, &mut row);
    }
    decoder.source.is_at_end().then_some(values)
}

#[derive(Clone, Copy)]
struct Context {
    a: i32,
    b: i32,
    c: i32,
    n: i32,
}

#[derive(Clone, Copy)]
struct RunContext {
    a: i32,
    n: i32,
    negative: i32,
}

struct Decoder<'a> {
    source: Bits<'a>,
    largest: i32,
    range: i32,
    value_bits: u32,
    limit: u32,
    reset: i32,
    contexts: Vec<Context>,
    interrupted: [RunContext; 2],
    run_index: usize,
    /// Class -4 to 4 of a gradient, by the gradient plus `largest`.
    classes: Vec<i8>,
}

impl<'a> Decoder<'a> {
    fn new(bits: u32, preset: Option<[u16; 5]>, data: &'a [u8]) -> Option<Self> {
        let [stated, t1, t2, t3, reset] = preset.unwrap_or([0; 5]).map(i32::from);
        let largest = (1i32 << bits) - 1;
        if stated != 0 && stated != largest {
            return None;
        }
        let basic = thresholds(largest);
        let given = [t1, t2, t3];
        let [t1, t2, t3] = std::array::from_fn(|n| if given[n] == 0 { basic[n] } else { given[n] });
        let reset = if reset == 0 { 64 } else { reset };
        if !(1 <= t1 && t1 <= t2 && t2 <= t3 && t3 <= largest) || reset < 3 {
            return None;
        }
        let a = ((largest + 1 + 32) / 64).max(2);
        let width = bits.max(2);
        let classes = (-largest..=largest)
            .map(|gradient| {
                let size = gradient.abs();
                let class = i8::from(size > 0)
                    + i8::from(size >= t1)
                    + i8::from(size >= t2)
                    + i8::from(size >= t3);
                if gradient < 0 { -class } else { class }
            })
            .collect();
        Some(Self {
            source: Bits {
                data,
                at: 0,
                word: 0,
                count: 0,
                padding: 0,
            },
            largest,
            range: largest + 1,
            value_bits: bits,
            limit: 2 * (width + width.max(8)),
            reset,
            contexts: vec![
                Context {
                    a,
                    b: 0,
                    c: 0,
                    n: 1
                };
                365
            ],
            interrupted: [RunContext {
                a,
                n: 1,
                negative: 0,
            }; 2],
            run_index: 0,
            classes,
        })
    }

    fn class(&self, gradient: i32) -> i32 {
        i32::from(self.classes[(gradient + self.largest) as usize])
    }

    fn row(&mut self, above: &[i32], row: &mut [i32]) -> Option<()> {
        let end = row.len() - 1;
        let mut at = 1;
        while at < end {
            let (a, b, c, d) = (row[at - 1], above[at], above[at - 1], above[at + 1]);
            let context = 81 * self.class(d - b) + 9 * self.class(b - c) + self.class(c - a);
            if context == 0 {
                at = self.run(above, row, at, end)?;
            } else {
                row[at] = self.regular(context, a, b, c)?;
                at += 1;
            }
        }
        Some(())
    }

    /// Decode a value in regular mode (A.4 to A.6).
    fn regular(&mut self, signed_context: i32, a: i32, b: i32, c: i32) -> Option<i32> {
        let sign = if signed_context < 0 { -1 } else { 1 };
        let context = &mut self.contexts[signed_context.unsigned_abs() as usize];
        let guess = if c >= a.max(b) {
            a.min(b)
        } else if c <= a.min(b) {
            a.max(b)
        } else {
            a + b - c
        };
        let guess = (guess + sign * context.c).clamp(0, self.largest);
        let mut k = 0;
        while context.n << k < context.a {
            k += 1;
        }
        let mapped = self.source.golomb(k, self.limit, self.value_bits)?;
        let mut error = (mapped >> 1) ^ -(mapped & 1);
        if k == 0 && 2 * context.b <= -context.n {
            error = !error;
        }
        context.b += error;
        context.a += error.abs();
        if context.n == self.reset {
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
        self.within(guess + sign * error)
    }

    /// Return a value modulo the range; `None` if no single addition of the range puts the value into the range.
    fn within(&self, value: i32) -> Option<i32> {
        let value = if value < 0 {
            value + self.range
        } else if value > self.largest {
            value - self.range
        } else {
            value
        };
        (0..=self.largest).contains(&value).then_some(value)
    }

    /// Decode a run and the value that interrupts it (A.7); return the index of the next value.
    fn run(&mut self, above: &[i32], row: &mut [i32], begin: usize, end: usize) -> Option<usize> {
        let a = row[begin - 1];
        let mut at = begin;
        while self.source.bits(1)? == 1 {
            let length = 1 << RUN_ORDER[self.run_index];
            let taken = length.min(end - at);
            at += taken;
            if taken == length {
                self.run_index = (self.run_index + 1).min(31);
            }
            if at == end {
                row[begin..end].fill(a);
                return Some(end);
            }
        }
        at += self.source.bits(RUN_ORDER[self.run_index])? as usize;
        if at >= end {
            return None;
        }
        row[begin..at].fill(a);
        let b = above[at];
        let alike = a == b;
        let error = self.interruption(usize::from(alike))?;
        let value = if alike || b > a { error } else { -error };
        row[at] = self.within(b + value)?;
        self.run_index = self.run_index.saturating_sub(1);
        Some(at + 1)
    }

    fn interruption(&mut self, kind: usize) -> Option<i32> {
        let context = &mut self.interrupted[kind];
        let size = context.a + if kind == 1 { context.n >> 1 } else { 0 };
        let mut k = 0;
        while context.n << k < size {
            k += 1;
        }
        let limit = self.limit - RUN_ORDER[self.run_index] - 1;
        let mapped = self.source.golomb(k, limit, self.value_bits)?;
        let whole = mapped + kind as i32;
        let is_odd = whole & 1 == 1;
        let magnitude = (whole + 1) >> 1;
        let error = if (k != 0 || 2 * context.negative >= context.n) == is_odd {
            -magnitude
        } else {
            magnitude
        };
        context.negative += i32::from(error < 0);
        context.a += (mapped + 1 - kind as i32) >> 1;
        if context.n == self.reset {
            context.a >>= 1;
            context.n >>= 1;
            context.negative >>= 1;
        }
        context.n += 1;
        Some(error)
    }
}

/// Return the basic thresholds of the gradients (T.87 C.2.4.1.1) without a loss.
fn thresholds(largest: i32) -> [i32; 3] {
    let scaled = if largest >= 128 {
        let factor = (largest.min(4095) + 128) / 256;
        [factor + 2, 4 * factor + 3, 17 * factor + 4]
    } else {
        let factor = 256 / (largest + 1);
        [
            (3 / factor).max(2),
            (7 / factor).max(3),
            (21 / factor).max(4),
        ]
    };
    let mut low = 1;
    scaled.map(|value| {
        low = if value > largest || value < low {
            low
        } else {
            value
        };
        low
    })
}

/// Bits of the coded data: seven bits of a byte after a byte FF, eight of each other byte.
struct Bits<'a> {
    data: &'a [u8],
    at: usize,
    /// The next bits, the first one in the most significant position.
    word: u64,
    count: u32,
    /// Number of zero bits that were added behind the data.
    padding: u32,
}

impl Bits<'_> {
    fn fill(&mut self) {
        while self.count <= 56 {
            let after_ff = self.at > 0 && self.data[self.at - 1] == 0xff;
            if let (false, Some(eight)) = (after_ff, self.data.get(self.at..self.at + 8)) {
                // Eight bytes without FF at once.
                if !eight.contains(&0xff) {
                    let taken = (64 - self.count) / 8;
                    let next = u64::from_be_bytes(eight.try_into().expect("eight bytes"));
                    let kept = if taken == 8 {
                        next
                    } else {
                        next >> (64 - 8 * taken) << (64 - 8 * taken)
                    };
                    self.word |= kept >> self.count;
                    self.count += 8 * taken;
                    self.at += taken as usize;
                    return;
                }
            }
            let Some(byte) = self.data.get(self.at) else {
                self.padding += 64 - self.count;
                self.count = 64;
                return;
            };
            let width = if after_ff { 7 } else { 8 };
            self.word |= u64::from(*byte) << (64 - width) >> self.count;
            self.count += width;
            self.at += 1;
        }
    }

    fn drop_bits(&mut self, count: u32) {
        self.word = if count < 64 { self.word << count } else { 0 };
        self.count -= count;
    }

    /// Return the next bits, at most 32; `None` behind the end of the data.
    fn bits(&mut self, count: u32) -> Option<i32> {
        if count == 0 {
            return Some(0);
        }
        if self.count < count {
            self.fill();
        }
        let value = (self.word >> (64 - count)) as i32;
        self.drop_bits(count);
        (self.padding <= self.count).then_some(value)
    }

    /// Return a value of a limited Golomb code (A.5.3).
    fn golomb(&mut self, k: u32, limit: u32, value_bits: u32) -> Option<i32> {
        if k > 24 {
            return None;
        }
        if self.count < 57 {
            self.fill();
        }
        let zeros = self.word.leading_zeros();
        // The longest code has limit - value_bits - 1 zeros, at most 47.
        let most = limit - value_bits - 1;
        if zeros < most {
            self.drop_bits(zeros + 1);
            Some((zeros as i32) << k | self.bits(k)?)
        } else {
            if self.word >> (63 - most) != 1 {
                return None;
            }
            self.drop_bits(most + 1);
            Some(self.bits(value_bits)? + 1)
        }
        .filter(|_| self.padding <= self.count)
    }

    /// Return whether the data were read to their last byte, and only zero bits are left.
    fn is_at_end(&self) -> bool {
        let left = self.count.saturating_sub(self.padding);
        self.at == self.data.len() && left < 8 && self.word == 0
    }
}
