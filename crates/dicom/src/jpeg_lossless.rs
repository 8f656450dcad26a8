//! Decoder of lossless JPEG with one grey value per pixel (ITU-T T.81 H, process 14).

use crate::segments::segments;

/// Decode a stream of a given size and depth; `None` for any other stream.
///
/// The entropy-coded data must contain exactly one code for each pixel with less than a byte left, and each value must
/// fit into the depth.
pub fn decode_lossless_jpeg(
    stream: &[u8],
    rows: usize,
    columns: usize,
    bits: u32,
) -> Option<Vec<u16>> {
    let found = segments(stream, 0xc3, |after| after != 0)?;
    let [table, predictor, last, transform] = found.scan;
    if (found.rows, found.columns, found.bits) != (rows, columns, bits) || !(2..=16).contains(&bits)
    {
        return None;
    }
    // The scan header states the predictor and the point transform; the end of the selection is always 0.
    if !(1..=7).contains(&predictor) || last != 0 || transform != 0 || table & 15 != 0 {
        return None;
    }
    let codes = Codes::new((*found.tables.get(usize::from(table >> 4))?)?)?;
    let mut source = Bits::new(found.data);
    let mut values = vec![0u16; rows * columns];
    decode_rows(&mut values, columns, bits, predictor, &codes, &mut source)?;
    let left = source.num_bits.checked_sub(source.at)?;
    let largest = ((1u32 << bits) - 1) as u16;
    (left < 8 && values.iter().all(|value| *value <= largest)).then_some(values)
}

fn decode_rows(
    values: &mut [u16],
    columns: usize,
    bits: u32,
    predictor: u8,
    codes: &Codes,
    source: &mut Bits,
) -> Option<()> {
    let (first, mut rest) = values.split_at_mut(columns);
    let mut left = 1u16 << (bits - 1);
    for value in first.iter_mut() {
        left = left.wrapping_add(codes.difference(source)?);
        *value = left;
    }
    let mut above: &mut [u16] = first;
    while !rest.is_empty() {
        let (row, next) = rest.split_at_mut(columns);
        let mut left = above[0].wrapping_add(codes.difference(source)?);
        row[0] = left;
        for at in 1..columns {
            let (a, b, c) = (
                i32::from(left),
                i32::from(above[at]),
                i32::from(above[at - 1]),
            );
            let guess = match predictor {
                1 => a,
                2 => b,
                3 => c,
                4 => a + b - c,
                5 => a + ((b - c) >> 1),
                6 => b + ((a - c) >> 1),
                _ => (a + b) >> 1,
            };
            left = (guess as u16).wrapping_add(codes.difference(source)?);
            row[at] = left;
        }
        (above, rest) = (row, next);
    }
    Some(())
}

/// Entropy-coded bytes without their stuffing.
struct Bits {
    bytes: Vec<u8>,
    num_bits: usize,
    at: usize,
}

impl Bits {
    fn new(data: &[u8]) -> Self {
        let mut bytes = Vec::with_capacity(data.len() + 8);
        let mut rest = data;
        while let Some(at) = rest.iter().position(|byte| *byte == 0xff) {
            bytes.extend_from_slice(&rest[..=at]);
            // A byte 00 follows each byte FF of the data.
            rest = &rest[(at + 2).min(rest.len())..];
        }
        bytes.extend_from_slice(rest);
        let num_bits = 8 * bytes.len();
        bytes.extend_from_slice(&[0xff; 8]);
        Self {
            bytes,
            num_bits,
            at: 0,
        }
    }

    /// Return the next 32 bits; ones follow the last bit.
    fn peek(&self) -> Option<u32> {
        let eight = self.bytes.get(self.at / 8..self.at / 8 + 8)?;
        let word = u64::from_be_bytes(eight.try_into().expect("eight bytes"));
        Some((word << (self.at % 8) >> 32) as u32)
    }
}

const FAST_BITS: usize = 10;

/// Huffman codes of the sizes of differences.
struct Codes {
    /// By the first bits: length of the code, and size of the difference; length 0 for a longer or invalid code.
    fast: Vec<(u8, u8)>,
    /// First code of each length, number of codes, and index of the first value.
    lengths: [(u32, u32, usize); 17],
    sizes: Vec<u8>,
}

impl Codes {
    fn new(table: &[u8]) -> Option<Self> {
        let sizes = table[16..].to_vec();
        if sizes.iter().any(|size| *size > 16) {
            return None;
        }
        let mut fast = vec![(0, 0); 1 << FAST_BITS];
        let mut lengths = [(0, 0, 0); 17];
        let (mut code, mut index) = (0u32, 0);
        for length in 1..=16 {
            let count = u32::from(table[length - 1]);
            lengths[length] = (code, count, index);
            for _ in 0..count {
                if length <= FAST_BITS {
                    let low = (code as usize) << (FAST_BITS - length);
                    let places = fast.get_mut(low..low + (1 << (FAST_BITS - length)))?;
                    places.fill((length as u8, sizes[index]));
                }
                code += 1;
                index += 1;
            }
            if code > 1 << length {
                return None;
            }
            code <<= 1;
        }
        Some(Self {
            fast,
            lengths,
            sizes,
        })
    }

    fn difference(&self, source: &mut Bits) -> Option<u16> {
        let word = source.peek()?;
        let (mut length, mut size) = self.fast[(word >> (32 - FAST_BITS)) as usize];
        if length == 0 {
            (length, size) = self.long(word)?;
        }
        if size == 0 {
            source.at += usize::from(length);
            return Some(0);
        }
        if size == 16 {
            source.at += usize::from(length);
            return Some(1 << 15);
        }
        let (length, size) = (u32::from(length), u32::from(size));
        let value = word << length >> (32 - size);
        source.at += (length + size) as usize;
        // A difference whose first bit is 0 is negative.
        let low = if value >> (size - 1) == 0 {
            (1 << size) - 1
        } else {
            0
        };
        Some((value as u16).wrapping_sub(low))
    }

    fn long(&self, word: u32) -> Option<(u8, u8)> {
        (FAST_BITS + 1..=16).find_map(|length| {
            let (first, count, index) = self.lengths[length];
            let number = (word >> (32 - length)).checked_sub(first)?;
            (number < count).then(|| (length as u8, self.sizes[index + number as usize]))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stream of 2 x 2 pixels of 8 bits with one code of one bit for the difference 0 and one for the size 1.
    fn stream(data: u8) -> Vec<u8> {
        let mut bytes = vec![0xff, 0xd8, 0xff, 0xc4, 0, 21, 0, 1, 1];
        bytes.extend([0; 14]);
        bytes.extend([0, 1]);
        bytes.extend([0xff, 0xc3, 0, 11, 8, 0, 2, 0, 2, 1, 1, 0x11, 0]);
        bytes.extend([0xff, 0xda, 0, 8, 1, 1, 0, 1, 0, 0, data, 0xff, 0xd9]);
        bytes
    }

    #[test]
    fn differences_are_added_to_the_predicted_values() {
        // Codes: 0 is the difference 0; 10 and a bit is the difference -1 or 1.
        let found = decode_lossless_jpeg(&stream(0b0_101_0_100), 2, 2, 8);
        assert_eq!(found, Some(vec![128, 129, 128, 127]));
    }

    #[test]
    fn streams_of_another_size_or_with_too_few_codes_are_not_decoded() {
        assert_eq!(decode_lossless_jpeg(&stream(0b0_101_0_100), 2, 3, 8), None);
        assert_eq!(decode_lossless_jpeg(&stream(0b0_101_0_100), 2, 2, 9), None);
        assert_eq!(decode_lossless_jpeg(&stream(0b1111_1111), 2, 2, 8), None);
        assert_eq!(decode_lossless_jpeg(&stream(0)[..40], 2, 2, 8), None);
    }
}
