//! Decoding of JPEG-LS streams with one grey value per pixel (ITU-T T.87 A).

use crate::jpeg_stream::{DecodedStream, data_before};

/// Number of errors after which the statistics of a context are halved (T.87 C.2.4.1.1).
const RESET: i32 = 64;
const NUM_CONTEXTS: usize = 365;
/// Logarithm of the length of the part of a run that one bit codes, by the run index (T.87 A.2.1).
const RUN_BITS: [u32; 32] = [
    0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 9, 10, 11, 12, 13,
    14, 15,
];
/// Largest k of a Golomb code that intact pixels need.
const MAX_K: u32 = 15;
/// Bits of the cache that the reader fills at least.
const FILLED: u32 = 57;

/// Decode an intact stream; `None` for any other or doubtful stream.
///
/// GDCM decides about the streams that are not decoded: several components or scans, restart intervals, mapping tables,
/// and those that decoders read differently: fewer than 8 bits, whose default thresholds GDCM computes unlike the
/// standard, and a MAXVAL or a RESET other than the default, which GDCM does not support.
///
/// Every code must be one that an encoder can write, and less than a byte of bits 0 may be left, so most damage is found.
pub fn decode_jpeg_ls(frame: &[u8], rows: usize, columns: usize) -> Option<DecodedStream> {
    let (scan, coded) = read_scan(frame, rows, columns)?;
    // Exactly one scan without markers in its data, the end marker, and at most bytes 0 behind it.
    let data = data_before(coded, |second| second >= 0x80);
    let end = coded.get(data.len()..data.len() + 2)?;
    if end != [0xff, 0xd9] || coded[data.len() + 2..].iter().any(|byte| *byte != 0) {
        return None;
    }
    let words = if scan.near == 0 {
        Decoder::<true>::new(&scan, data).decode(rows, columns)?
    } else {
        Decoder::<false>::new(&scan, data).decode(rows, columns)?
    };
    let bits = scan.bits;
    Some(DecodedStream { words, bits })
}

/// Parameters of the only scan of a grey stream.
struct Scan {
    bits: u32,
    /// Largest difference of a decoded value to the original one; 0 for a lossless stream.
    near: i32,
    /// Thresholds of the gradients: T1, T2, T3.
    thresholds: [i32; 3],
}

/// Read the header of a stream; return its scan and the coded data up to the end of the stream.
fn read_scan(frame: &[u8], rows: usize, columns: usize) -> Option<(Scan, &[u8])> {
    let mut rest = frame.strip_prefix(&[0xff, 0xd8])?;
    let (mut frame_header, mut stated) = (None, [0; 5]);
    loop {
        let [0xff, marker, high, low, ..] = *rest else {
            return None;
        };
        let end = 2 + usize::from(u16::from_be_bytes([high, low]));
        let body = rest.get(4..end)?;
        rest = &rest[end..];
        match (marker, body) {
            (0xf7, &[bits, r1, r0, c1, c0, 1, id, 0x11, 0]) if frame_header.is_none() => {
                let sides = [[r1, r0], [c1, c0]].map(|two| usize::from(u16::from_be_bytes(two)));
                // Compared before any memory is allocated.
                if sides != [rows, columns] || rows * columns == 0 || !(8..=16).contains(&bits) {
                    return None;
                }
                frame_header = Some((u32::from(bits), id));
            }
            (0xf8, &[1, ref words @ ..]) if words.len() == 10 => {
                for (number, two) in stated.iter_mut().zip(words.chunks_exact(2)) {
                    *number = i32::from(u16::from_be_bytes([two[0], two[1]]));
                }
            }
            (0xda, &[1, id, 0, near, 0, 0]) => {
                let (bits, _) = frame_header.filter(|(_, other)| *other == id)?;
                let max = (1 << bits) - 1;
                let near = i32::from(near);
                let [stated_max, thresholds @ .., reset] = stated;
                let thresholds = thresholds_or_default(thresholds, max, near);
                let [t1, t2, t3] = thresholds;
                let is_valid = near <= max / 2
                    && [0, max].contains(&stated_max)
                    && [0, RESET].contains(&reset)
                    && (near < t1 && t1 <= t2 && t2 <= t3 && t3 <= max);
                let scan = Scan {
                    bits,
                    near,
                    thresholds,
                };
                return is_valid.then_some((scan, rest));
            }
            // An application's data without an effect on the pixels, or a comment.
            (0xe0 | 0xfe, _) => {}
            _ => return None,
        }
    }
}

/// Replace thresholds that are 0 by the default ones (T.87 C.2.4.1.1) for values of at least 8 bits.
fn thresholds_or_default(stated: [i32; 3], max: i32, near: i32) -> [i32; 3] {
    let factor = (max.min(4095) + 128) / 256;
    let defaults = [
        factor + 2 + 3 * near,
        4 * factor + 3 + 5 * near,
        17 * factor + 4 + 7 * near,
    ];
    let (mut found, mut least) = (stated, near + 1);
    for (number, default) in found.iter_mut().zip(defaults) {
        // A default above the range of the values is replaced by the threshold before it.
        least = if default > max || default < least {
            least
        } else {
            default
        };
        if *number == 0 {
            *number = least;
        }
    }
    found
}

/// Statistics of the prediction errors in one context (T.87 A.2.1).
#[derive(Clone, Copy)]
struct Context {
    /// Sum of the sizes of the errors.
    a: i32,
    /// Sum of the errors, from which the correction is computed.
    b: i32,
    /// Correction of the prediction.
    c: i32,
    /// Number of errors.
    n: i32,
}

/// Statistics of the errors of the pixels that end a run.
#[derive(Clone, Copy)]
struct RunContext {
    a: i32,
    n: i32,
    num_negative: i32,
}

/// Decoder of one scan; without loss, the steps for near-lossless streams are left out.
struct Decoder<'a, const LOSSLESS: bool> {
    bits: Bits<'a>,
    max: i32,
    near: i32,
    /// Number of the different prediction errors.
    range: i32,
    error_bits: u32,
    /// Longest code, bits.
    limit: u32,
    /// Class of each gradient from -T3 to T3.
    classes: Vec<i8>,
    contexts: [Context; NUM_CONTEXTS],
    run_contexts: [RunContext; 2],
    run_index: usize,
}

impl<'a, const LOSSLESS: bool> Decoder<'a, LOSSLESS> {
    fn new(scan: &Scan, data: &'a [u8]) -> Self {
        let (near, max) = (scan.near, (1 << scan.bits) - 1);
        let range = (max + 2 * near) / (2 * near + 1) + 1;
        let [t1, t2, t3] = scan.thresholds;
        let class = |gradient: i32| -> i8 {
            let size = match gradient.abs() {
                size if size >= t3 => 4,
                size if size >= t2 => 3,
                size if size >= t1 => 2,
                size => i8::from(size > near),
            };
            if gradient < 0 { -size } else { size }
        };
        let a = ((range + 32) / 64).max(2);
        Self {
            bits: Bits::new(data),
            max,
            near,
            range,
            error_bits: 32 - (range - 1).leading_zeros(),
            limit: 2 * (scan.bits + scan.bits.max(8)),
            classes: (-t3..=t3).map(class).collect(),
            contexts: [Context {
                a,
                b: 0,
                c: 0,
                n: 1,
            }; NUM_CONTEXTS],
            run_contexts: [RunContext {
                a,
                n: 1,
                num_negative: 0,
            }; 2],
            run_index: 0,
        }
    }

    fn decode(mut self, rows: usize, columns: usize) -> Option<Vec<u16>> {
        let mut words = Vec::with_capacity(rows * columns);
        // One value before each line and one behind it are its neighbours at the edges (T.87 A.2.1).
        let (mut above, mut line) = (vec![0; columns + 2], vec![0; columns + 2]);
        for _ in 0..rows {
            line[0] = above[1];
            above[columns + 1] = above[columns];
            self.decode_line(&above, &mut line)?;
            words.extend(line[1..=columns].iter().map(|value| *value as u16));
            std::mem::swap(&mut above, &mut line);
        }
        self.bits.are_used_up().then_some(words)
    }

    fn decode_line(&mut self, above: &[i32], line: &mut [i32]) -> Option<()> {
        let columns = line.len() - 2;
        let mut x = 1;
        while x <= columns {
            let (ra, rb, rc, rd) = (line[x - 1], above[x], above[x - 1], above[x + 1]);
            let class = 81 * self.class(rd - rb) + 9 * self.class(rb - rc) + self.class(rc - ra);
            if class == 0 {
                x = self.decode_run(above, line, x)?;
            } else {
                let predicted = (ra + rb - rc).clamp(ra.min(rb), ra.max(rb));
                line[x] = self.decode_pixel(class, predicted)?;
                x += 1;
            }
        }
        Some(())
    }

    fn class(&self, gradient: i32) -> i32 {
        let most = (self.classes.len() / 2) as i32;
        i32::from(self.classes[(gradient.clamp(-most, most) + most) as usize])
    }

    /// Decode a pixel in a context (T.87 A.4 to A.6).
    #[inline]
    fn decode_pixel(&mut self, class: i32, predicted: i32) -> Option<i32> {
        let sign = class >> 31;
        let context = &mut self.contexts[((class ^ sign) - sign) as usize];
        let k = golomb_k(context.a, context.n)?;
        let mapped = self
            .bits
            .code(k, self.limit - self.error_bits - 1, self.error_bits)?;
        let mut error = (mapped >> 1) ^ -(mapped & 1);
        if LOSSLESS && k == 0 && 2 * context.b <= -context.n {
            error = !error;
        }
        check_error(error, self.range)?;
        let predicted = (predicted + ((context.c ^ sign) - sign)).clamp(0, self.max);
        context.a += error.abs();
        context.b += if LOSSLESS {
            error
        } else {
            error * (2 * self.near + 1)
        };
        if context.n == RESET {
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
        Some(self.value(predicted, (error ^ sign) - sign))
    }

    /// Decode a run of equal pixels and the pixel that ends the run (T.87 A.7); return the column behind these pixels.
    fn decode_run(&mut self, above: &[i32], line: &mut [i32], begin: usize) -> Option<usize> {
        let behind = line.len() - 1;
        let run_value = line[begin - 1];
        let mut end = begin;
        while end < behind && self.bits.take(1) == 1 {
            let length = 1 << RUN_BITS[self.run_index];
            if length <= behind - end {
                end += length;
                self.run_index = (self.run_index + 1).min(RUN_BITS.len() - 1);
            } else {
                end = behind;
            }
        }
        if end == behind {
            line[begin..end].fill(run_value);
            return Some(end);
        }
        let run_bits = RUN_BITS[self.run_index];
        end += self.bits.take(run_bits) as usize;
        if end >= behind {
            return None;
        }
        line[begin..end].fill(run_value);
        let is_near = (run_value - above[end]).abs() <= self.near;
        let kind = i32::from(is_near);
        let context = &mut self.run_contexts[usize::from(is_near)];
        let k = golomb_k(context.a + kind * (context.n >> 1), context.n)?;
        let zeros = self.limit - run_bits - 1 - self.error_bits - 1;
        let mapped = self.bits.code(k, zeros, self.error_bits)?;
        let is_odd = (mapped + kind) & 1;
        let size = (mapped + kind + is_odd) >> 1;
        let is_negative = (k != 0 || 2 * context.num_negative >= context.n) == (is_odd == 1);
        let error = if is_negative { -size } else { size };
        check_error(error, self.range)?;
        context.num_negative += i32::from(error < 0);
        context.a += (mapped + 1 - kind) >> 1;
        if context.n == RESET {
            context.a >>= 1;
            context.n >>= 1;
            context.num_negative >>= 1;
        }
        context.n += 1;
        self.run_index = self.run_index.saturating_sub(1);
        line[end] = if is_near {
            self.value(run_value, error)
        } else {
            let rises = above[end] > run_value;
            self.value(above[end], if rises { error } else { -error })
        };
        Some(end + 1)
    }

    /// Return the value of a pixel from its prediction and its error (T.87 A.4.4, A.4.5).
    fn value(&self, predicted: i32, error: i32) -> i32 {
        if LOSSLESS {
            return (predicted + error) & self.max;
        }
        let step = 2 * self.near + 1;
        let sum = predicted + error * step;
        let value = if sum < -self.near {
            sum + self.range * step
        } else if sum > self.max + self.near {
            sum - self.range * step
        } else {
            sum
        };
        value.clamp(0, self.max)
    }
}

/// Return the smallest k with n * 2^k >= a; `None` if it is larger than intact pixels need.
fn golomb_k(a: i32, n: i32) -> Option<u32> {
    let difference = n.leading_zeros() as i32 - a.leading_zeros() as i32;
    let k = difference.max(0);
    let k = k as u32 + u32::from(n << k < a);
    (k <= MAX_K).then_some(k)
}

/// Check that an encoder can write an error.
fn check_error(error: i32, range: i32) -> Option<()> {
    (((error + range / 2) as u32) < range as u32).then_some(())
}

/// Reader of coded bits; the first bit of the byte behind a byte 255 is not data (T.87 A.1).
struct Bits<'a> {
    data: &'a [u8],
    at: usize,
    /// The next bits, the first of them in the most significant place.
    cache: u64,
    num_cached: u32,
    /// Bits of the cache behind the end of the data; they are 0.
    num_missing: u32,
}

impl<'a> Bits<'a> {
    fn new(data: &'a [u8]) -> Self {
        Self {
            data,
            at: 0,
            cache: 0,
            num_cached: 0,
            num_missing: 0,
        }
    }

    /// Fill the cache with at least 57 bits.
    #[inline]
    fn fill(&mut self) {
        if let Some(bytes) = self.data.get(self.at..self.at + 8) {
            let word = u64::from_be_bytes(bytes.try_into().expect("eight bytes"));
            let bytes_255 =
                (!word).wrapping_sub(0x0101_0101_0101_0101) & word & 0x8080_8080_8080_8080;
            if bytes_255 == 0 && (self.at == 0 || self.data[self.at - 1] != 0xff) {
                let num_bytes = (64 - self.num_cached) >> 3;
                let num_bits = 8 * num_bytes;
                self.cache |= word >> (64 - num_bits) << (64 - num_bits) >> self.num_cached;
                self.num_cached += num_bits;
                self.at += num_bytes as usize;
                return;
            }
        }
        self.fill_by_bytes();
    }

    #[cold]
    fn fill_by_bytes(&mut self) {
        while self.num_cached < FILLED {
            let Some(byte) = self.data.get(self.at) else {
                self.num_missing += 8;
                self.num_cached += 8;
                continue;
            };
            let is_stuffed = self.at > 0 && self.data[self.at - 1] == 0xff;
            let width = 8 - u32::from(is_stuffed);
            self.cache |= u64::from(*byte) << (64 - width - self.num_cached);
            self.num_cached += width;
            self.at += 1;
        }
    }

    fn skip(&mut self, num: u32) {
        self.cache <<= num;
        self.num_cached -= num;
    }

    /// Return the next bits, at most 16, as a number.
    fn take(&mut self, num: u32) -> u32 {
        if self.num_cached < num {
            self.fill();
        }
        let value = (self.cache >> 32 >> (32 - num)) as u32;
        self.skip(num);
        value
    }

    /// Read a Golomb code of limited length (T.87 A.5.3): zeros and a one, and k bits or, behind `max_zeros`, all bits.
    #[inline]
    fn code(&mut self, k: u32, max_zeros: u32, error_bits: u32) -> Option<i32> {
        if self.num_cached < 32 {
            self.fill();
        }
        let zeros = self.cache.leading_zeros();
        if zeros < max_zeros && zeros + 1 + k <= self.num_cached {
            self.skip(zeros + 1);
            let low = (self.cache >> 32 >> (32 - k)) as u32;
            self.skip(k);
            return Some((zeros << k | low) as i32);
        }
        self.long_code(k, max_zeros, error_bits)
    }

    #[cold]
    fn long_code(&mut self, k: u32, max_zeros: u32, error_bits: u32) -> Option<i32> {
        if self.num_cached < FILLED {
            self.fill();
        }
        let zeros = self.cache.leading_zeros();
        if zeros > max_zeros {
            return None;
        }
        self.skip(zeros + 1);
        if zeros == max_zeros {
            return Some(self.take(error_bits) as i32 + 1);
        }
        let low = self.take(k);
        Some((zeros << k | low) as i32)
    }

    /// Return whether all data were read, except less than a byte of bits 0.
    fn are_used_up(&mut self) -> bool {
        if self.num_cached < FILLED {
            self.fill();
        }
        let is_end = self.at == self.data.len();
        is_end
            && self.cache == 0
            && self.num_missing <= self.num_cached
            && self.num_cached - self.num_missing < 8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stream of the example of T.87 H.3.
    const EXAMPLE: [u8; 59] = [
        0xff, 0xd8, 0xff, 0xf7, 0, 11, 8, 0, 4, 0, 4, 1, 1, 0x11, 0, 0xff, 0xda, 0, 8, 1, 1, 0, 0,
        0, 0, 0xc0, 0x00, 0x00, 0x6c, 0x80, 0x20, 0x8e, 0x01, 0xc0, 0x00, 0x00, 0x57, 0x40, 0x00,
        0x00, 0x6e, 0xe6, 0x00, 0x00, 0x01, 0xbc, 0x18, 0x00, 0x00, 0x05, 0xd8, 0x00, 0x00, 0x91,
        0x60, 0xff, 0xd9, 0, 0,
    ];
    const PIXELS: [u16; 16] = [
        0, 0, 90, 74, 68, 50, 43, 205, 64, 145, 145, 145, 100, 145, 145, 145,
    ];
    const FRAME_HEADER: usize = 2;
    const SCAN_HEADER: usize = 15;
    const CODED: usize = 25;

    fn with(at: usize, bytes: &[u8]) -> Vec<u8> {
        let mut stream = EXAMPLE.to_vec();
        stream.splice(at..at, bytes.iter().copied());
        stream
    }

    fn preset(words: [u16; 5]) -> Vec<u8> {
        let mut bytes = vec![0xff, 0xf8, 0, 13, 1];
        bytes.extend(words.iter().flat_map(|word| word.to_be_bytes()));
        bytes
    }

    fn pixels(stream: &[u8]) -> Option<Vec<u16>> {
        decode_jpeg_ls(stream, 4, 4).map(|found| found.words)
    }

    #[test]
    fn example_of_the_standard_has_its_pixels() {
        let found = decode_jpeg_ls(&EXAMPLE, 4, 4).unwrap();
        assert_eq!((found.words, found.bits), (PIXELS.to_vec(), 8));
        for stated in [[0; 5], [255, 3, 7, 21, 64]] {
            let stream = with(SCAN_HEADER, &preset(stated));
            assert_eq!(pixels(&stream).as_deref(), Some(&PIXELS[..]));
        }
        let comment = [0xff, 0xfe, 0, 4, 1, 2];
        assert!(pixels(&with(FRAME_HEADER, &comment)).is_some());
    }

    #[test]
    fn truncated_streams_and_streams_with_further_data_are_not_decoded() {
        for length in 0..EXAMPLE.len() - 2 {
            assert_eq!(pixels(&EXAMPLE[..length]), None);
        }
        let end = EXAMPLE.len() - 4;
        for further in [&[0x00][..], &[0x80], &[0xff, 0xd0], &[0xff, 0x00], &[0xff]] {
            assert_eq!(pixels(&with(end, further)), None);
        }
        assert_eq!(pixels(&with(EXAMPLE.len(), &[1])), None);
        let mut padded = EXAMPLE.to_vec();
        padded[end - 1] |= 1;
        assert_eq!(pixels(&padded), None);
    }

    #[test]
    fn streams_of_another_kind_or_size_are_not_decoded() {
        assert_eq!(decode_jpeg_ls(&EXAMPLE, 4, 5), None);
        assert_eq!(decode_jpeg_ls(&EXAMPLE, 8, 2), None);
        // Bits, components, mapping table, near-lossless range, interleaving, point transform.
        for (at, value) in [
            (6, 7),
            (6, 17),
            (11, 3),
            (21, 1),
            (22, 128),
            (23, 1),
            (24, 1),
        ] {
            let mut stream = EXAMPLE.to_vec();
            stream[at] = value;
            assert_eq!(pixels(&stream), None, "byte {at}");
        }
        let restarts = [0xff, 0xdd, 0, 4, 0, 2];
        assert_eq!(pixels(&with(SCAN_HEADER, &restarts)), None);
        for stated in [
            [254, 0, 0, 0, 0],
            [0, 0, 0, 0, 32],
            [0, 7, 3, 21, 0],
            [0, 3, 7, 256, 0],
        ] {
            assert_eq!(pixels(&with(SCAN_HEADER, &preset(stated))), None);
        }
    }

    #[test]
    fn no_changed_stream_panics() {
        for at in CODED..EXAMPLE.len() - 4 {
            for value in 0..=255 {
                let mut stream = EXAMPLE.to_vec();
                stream[at] = value;
                let found = pixels(&stream);
                assert!(found.is_none_or(|words| words.iter().all(|word| *word < 256)));
            }
        }
    }
}
