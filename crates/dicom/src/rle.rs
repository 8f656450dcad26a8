//! Decoder of RLE frames with one grey value per pixel (PS3.5 G).

/// Decode a frame of `num_pixels` values of one or two bytes; `None` unless its segments unpack to exactly the pixels.
pub fn decode_rle(frame: &[u8], num_pixels: usize, num_bytes: usize) -> Option<Vec<u16>> {
    let header: Vec<usize> = frame
        .get(..64)?
        .chunks_exact(4)
        .map(|four| u32::from_le_bytes(four.try_into().expect("four bytes")) as usize)
        .collect();
    if header[0] != num_bytes || !(1..=2).contains(&num_bytes) {
        return None;
    }
    let mut values = vec![0u16; num_pixels];
    let mut unpacked = Vec::with_capacity(num_pixels + 128);
    for segment in 0..num_bytes {
        let begin = header[1 + segment];
        let end = if segment + 1 < num_bytes {
            header[2 + segment]
        } else {
            frame.len()
        };
        if begin < 64 || begin > end || end > frame.len() {
            return None;
        }
        unpack(&frame[begin..end], num_pixels, &mut unpacked)?;
        // The most significant byte has the first segment.
        for (value, byte) in values.iter_mut().zip(&unpacked) {
            *value = *value << 8 | u16::from(*byte);
        }
    }
    Some(values)
}

/// Unpack one segment; `None` unless it has exactly `num_pixels` bytes and at most two bytes are left.
fn unpack(segment: &[u8], num_pixels: usize, out: &mut Vec<u8>) -> Option<()> {
    out.clear();
    let mut at = 0;
    while at < segment.len() && out.len() < num_pixels {
        let code = segment[at];
        match code {
            0..128 => {
                let end = at + 2 + code as usize;
                out.extend_from_slice(segment.get(at + 1..end)?);
                at = end;
            }
            128 => at += 1,
            129.. => {
                let byte = *segment.get(at + 1)?;
                out.resize(out.len() + 257 - code as usize, byte);
                at += 2;
            }
        }
    }
    (out.len() == num_pixels && segment.len() - at <= 2).then_some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(segments: &[&[u8]]) -> Vec<u8> {
        let mut header = vec![segments.len() as u32];
        let mut at = 64;
        for segment in segments {
            header.push(at as u32);
            at += segment.len();
        }
        header.resize(16, 0);
        let mut bytes: Vec<u8> = header.iter().flat_map(|n| n.to_le_bytes()).collect();
        for segment in segments {
            bytes.extend_from_slice(segment);
        }
        bytes
    }

    #[test]
    fn literal_and_repeated_bytes_are_unpacked_most_significant_first() {
        let bytes = frame(&[&[253, 1], &[3, 5, 6, 7, 8]]);
        assert_eq!(
            decode_rle(&bytes, 4, 2),
            Some(vec![0x105, 0x106, 0x107, 0x108])
        );
    }

    #[test]
    fn segments_with_too_few_or_too_many_pixels_are_not_decoded() {
        let bytes = frame(&[&[253, 1], &[2, 5, 6, 7]]);
        assert_eq!(decode_rle(&bytes, 4, 2), None);
        let bytes = frame(&[&[252, 1], &[3, 5, 6, 7, 8]]);
        assert_eq!(decode_rle(&bytes, 4, 2), None);
        assert_eq!(decode_rle(&bytes[..60], 4, 2), None);
    }
}
