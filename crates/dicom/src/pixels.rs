//! Reading of the pixels of many slices into one volume, on all cores.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::PathBuf;

use rayon::prelude::*;

use crate::header::{inflated_pixels, open_regular};
use crate::{decode_jpeg_ls, decode_lossless_jpeg, decode_rle};

const UNDEFINED: u32 = u32::MAX;
const ITEM: [u8; 4] = [0xfe, 0xff, 0x00, 0xe0];
const END_OF_ITEMS: [u8; 4] = [0xfe, 0xff, 0xdd, 0xe0];
/// Padding at or below this value cannot be confused with tissue, HU.
const HARMLESS_HU: i32 = -1000;
/// Least value of four equal corners that is padding, HU; a larger value than the second in any corner is padding, too.
const CORNER_HU: (i32, i32) = (2000, 30_710);
/// Mean difference of neighbouring pixels from which a slice may be noise, because its bytes are swapped.
const ROUGH: u64 = 200;
/// Largest file with compressed pixels that is read, bytes; each core may read one.
const MAX_PACKED: u64 = 1 << 26;
/// Number of rows that are examined for swapped bytes.
const ROUGH_ROWS: usize = 32;

/// Coding of the pixels of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coding {
    /// Numbers in implicit little-endian files.
    Implicit,
    /// Numbers in explicit little-endian files.
    Little,
    /// Numbers in explicit big-endian files.
    Big,
    /// Numbers in deflated files.
    Deflated,
    /// RLE.
    Rle,
    /// JPEG-LS, lossless or near-lossless.
    JpegLs,
    /// Lossless JPEG.
    LosslessJpeg,
}

/// Format of the slices of one call.
#[derive(Clone, Debug)]
pub struct SliceFormat {
    /// Coding of the pixels.
    pub coding: Coding,
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub columns: usize,
    /// Bits of a stored word: 8 or 16.
    pub bits_allocated: u32,
    /// Bits of a stored number.
    pub bits_stored: u32,
    /// Most significant bit of a stored number.
    pub high_bit: u32,
    /// Whether stored numbers are signed.
    pub signed: bool,
    /// Number that is added to a stored number; the slope is 1.
    pub intercept: i32,
    /// Lowest and highest stored numbers that mark padding; `None` if the slices are not searched for padding.
    pub padding: Option<Vec<(i32, i32)>>,
    /// Largest decompressed size of a deflated file, bytes.
    pub max_inflated: usize,
}

/// File of a slice.
#[derive(Clone, Debug)]
pub struct SliceSource {
    /// Path of the file.
    pub path: PathBuf,
    /// Offset of the element `PixelData`; not used for deflated files.
    pub pixels_at: u64,
    /// Index of the slice in the volume.
    pub level: usize,
}

/// Read slices into the volume `out`, and return for each whether it was read.
///
/// A slice is read only if nothing about it is remarkable: the stored data have exactly the expected size, the coded
/// data are intact, every value fits into int16, no pixel is padding that looks like tissue, and the pixels are not
/// noise. The content of the other slices is undefined. Two sources must not have one level. When
/// `should_continue(share)` returns false, the call ends early.
pub fn decode_slices(
    sources: &[SliceSource],
    format: &SliceFormat,
    out: &mut [i16],
    should_continue: impl Fn(f64) -> bool + Sync,
) -> Vec<bool> {
    let size = format.rows * format.columns;
    let mut planes: Vec<Option<&mut [i16]>> = out.chunks_exact_mut(size).map(Some).collect();
    let jobs: Vec<(&SliceSource, Option<&mut [i16]>)> = sources
        .iter()
        .map(|source| (source, planes.get_mut(source.level).and_then(Option::take)))
        .collect();
    let num_done = std::sync::atomic::AtomicUsize::new(0);
    jobs.into_par_iter()
        .with_max_len(1)
        .map_init(Vec::new, |buffer, (source, plane)| {
            let done = num_done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            if !should_continue(done as f64 / sources.len() as f64) {
                return false;
            }
            plane.is_some_and(|plane| read_slice(source, format, buffer, plane).is_some())
        })
        .collect()
}

fn read_slice(
    source: &SliceSource,
    format: &SliceFormat,
    buffer: &mut Vec<u8>,
    out: &mut [i16],
) -> Option<()> {
    let words = match format.coding {
        Coding::Implicit | Coding::Little | Coding::Big => {
            let at = read_plain(source, format, buffer)?;
            stored_words(&buffer[at..], format)
        }
        Coding::Deflated => {
            let (bytes, at) = inflated_pixels(&source.path, format.max_inflated)?;
            let (begin, length) = value_of_element(bytes.get(at..at + 12)?, format.coding)?;
            check_length(length, format)?;
            // The reference parses the whole data set, so nothing may follow the pixels.
            if at + begin + length as usize != bytes.len() {
                return None;
            }
            let end = at + begin + size_bytes(format);
            stored_words(bytes.get(at + begin..end)?, format)
        }
        Coding::Rle => {
            let stream = read_stream(source, buffer)?;
            let words = decode_rle(
                &stream,
                format.rows * format.columns,
                format.bits_allocated as usize / 8,
            )?;
            fits_into_tags(&words, format.bits_allocated, format).then_some(words)?
        }
        Coding::JpegLs => {
            let stream = read_stream(source, buffer)?;
            let found = decode_jpeg_ls(&stream, format.rows, format.columns)?;
            // GDCM cannot read words of another size than that of the tags.
            let is_byte = found.bits <= 8;
            let fits = is_byte == (format.bits_allocated == 8)
                && fits_into_tags(&found.words, found.bits, format);
            fits.then_some(found.words)?
        }
        Coding::LosslessJpeg => {
            let stream = read_stream(source, buffer)?;
            let found = decode_lossless_jpeg(&stream, format.rows, format.columns)?;
            fits_into_tags(&found.words, found.bits, format).then_some(found.words)?
        }
    };
    to_volume(&words, format, out)
}

/// Write decoded words of `bits` bits into a slice of the volume as `decode_slices` does; return whether nothing about
/// them is remarkable.
pub fn place_words(words: &[u16], bits: u32, format: &SliceFormat, out: &mut [i16]) -> bool {
    fits_into_tags(words, bits, format) && to_volume(words, format, out).is_some()
}

/// Return whether words of `bits` bits have the same meaning with the bits and the sign that the tags state.
///
/// GDCM does not change the sign or the unused bits of a decoded number.
fn fits_into_tags(words: &[u16], bits: u32, format: &SliceFormat) -> bool {
    let used = bits.min(format.bits_stored);
    format.high_bit + 1 == format.bits_stored
        && bits <= format.bits_allocated
        && if format.signed {
            used == format.bits_allocated
        } else {
            used == 16 || words.iter().all(|word| *word >> used == 0)
        }
}

fn size_bytes(format: &SliceFormat) -> usize {
    format.rows * format.columns * format.bits_allocated as usize / 8
}

/// Return the offset and the length of the value of the element `PixelData`, from its first 12 bytes.
fn value_of_element(head: &[u8], coding: Coding) -> Option<(usize, u32)> {
    let tag = if coding == Coding::Big {
        [0x7f, 0xe0, 0, 0x10]
    } else {
        [0xe0, 0x7f, 0x10, 0]
    };
    if head[..4] != tag {
        return None;
    }
    let word = |at: usize| -> [u8; 4] { head[at..at + 4].try_into().expect("four bytes") };
    match (coding, &head[4..6]) {
        (Coding::Implicit, _) => Some((8, u32::from_le_bytes(word(4)))),
        (Coding::Big, b"OW" | b"OB" | b"UN") => Some((12, u32::from_be_bytes(word(8)))),
        (_, b"OW" | b"OB" | b"UN") => Some((12, u32::from_le_bytes(word(8)))),
        _ => None,
    }
}

/// Check the length of uncompressed pixels: one byte of padding makes the length even.
fn check_length(length: u32, format: &SliceFormat) -> Option<()> {
    let surplus = (length != UNDEFINED)
        .then_some(length as usize)?
        .checked_sub(size_bytes(format))?;
    (surplus <= 1).then_some(())
}

/// Read the element `PixelData` of an uncompressed file, and return the offset of its value in the buffer.
fn read_plain(source: &SliceSource, format: &SliceFormat, buffer: &mut Vec<u8>) -> Option<usize> {
    let mut file = open_at(source)?;
    buffer.resize(12 + size_bytes(format), 0);
    file.read_exact(&mut buffer[..12]).ok()?;
    let (begin, length) = value_of_element(&buffer[..12], format.coding)?;
    check_length(length, format)?;
    buffer.truncate(begin + size_bytes(format));
    file.read_exact(&mut buffer[12..]).ok()?;
    Some(begin)
}

fn open_at(source: &SliceSource) -> Option<File> {
    let mut file = open_regular(&source.path)?;
    file.seek(SeekFrom::Start(source.pixels_at)).ok()?;
    Some(file)
}

/// Return the joined fragments of a compressed file with one frame (PS3.5 A.4), without the offset table.
fn read_stream(source: &SliceSource, buffer: &mut Vec<u8>) -> Option<Vec<u8>> {
    let file = open_at(source)?;
    buffer.clear();
    file.take(MAX_PACKED).read_to_end(buffer).ok()?;
    if buffer.len() as u64 == MAX_PACKED {
        return None;
    }
    let (begin, length) = value_of_element(buffer.get(..12)?, Coding::Little)?;
    let end = if length == UNDEFINED {
        buffer.len()
    } else {
        buffer.len().min(begin + length as usize)
    };
    let stored = buffer.get(begin..end)?;
    let (mut at, mut num, mut stream) = (0, 0, Vec::new());
    while let Some(head) = stored.get(at..at + 8) {
        if head[..4] == END_OF_ITEMS {
            break;
        }
        let length = u32::from_le_bytes(head[4..].try_into().expect("four bytes")) as usize;
        let part = stored.get(at + 8..at.checked_add(8 + length)?)?;
        if head[..4] != ITEM {
            return None;
        }
        if num > 0 {
            stream.extend_from_slice(part);
        }
        num += 1;
        at += 8 + length;
    }
    (num > 1).then_some(stream)
}

fn stored_words(bytes: &[u8], format: &SliceFormat) -> Vec<u16> {
    if format.bits_allocated == 8 {
        return bytes.iter().map(|byte| u16::from(*byte)).collect();
    }
    let pairs = bytes.chunks_exact(2).map(|pair| [pair[0], pair[1]]);
    if format.coding == Coding::Big {
        pairs.map(u16::from_be_bytes).collect()
    } else {
        pairs.map(u16::from_le_bytes).collect()
    }
}

/// Convert stored words to values, unless something about them is remarkable.
fn to_volume(words: &[u16], format: &SliceFormat, out: &mut [i16]) -> Option<()> {
    if words.len() != out.len() {
        return None;
    }
    // Bits outside the used ones may contain other data, so both ends are shifted out.
    let (up, down) = (31 - format.high_bit, 32 - format.bits_stored);
    let stored = |word: u16| -> i32 {
        let word = u32::from(word) << up;
        if format.signed {
            word as i32 >> down
        } else {
            (word >> down) as i32
        }
    };
    let (mut low, mut high) = (i32::MAX, i32::MIN);
    for (value, word) in out.iter_mut().zip(words) {
        let number = stored(*word) + format.intercept;
        low = low.min(number);
        high = high.max(number);
        *value = number as i16;
    }
    if low < i32::from(i16::MIN) || high > i32::from(i16::MAX) {
        return None;
    }
    if let Some(ranges) = &format.padding {
        let is_marked = |value: i32| {
            ranges.iter().any(|(first, last)| {
                (first + format.intercept..=last + format.intercept).contains(&value)
            })
        };
        // A mark that only harmless pixels have needs no search.
        let may_matter = ranges
            .iter()
            .any(|(_, last)| last + format.intercept > HARMLESS_HU);
        if may_matter
            && out
                .iter()
                .any(|value| i32::from(*value) > HARMLESS_HU && is_marked(i32::from(*value)))
        {
            return None;
        }
        let end = out.len() - 1;
        let corners =
            [0, format.columns - 1, end + 1 - format.columns, end].map(|at| i32::from(out[at]));
        let alike = corners.iter().all(|corner| *corner == corners[0]);
        if (alike && corners[0] >= CORNER_HU.0)
            || corners.iter().any(|corner| *corner > CORNER_HU.1)
        {
            return None;
        }
    }
    (format.bits_allocated == 8 || is_smooth(words, format, stored)).then_some(())
}

/// Return whether neighbouring pixels differ so little that the bytes of the words are certainly not swapped.
fn is_smooth(words: &[u16], format: &SliceFormat, stored: impl Fn(u16) -> i32) -> bool {
    let every = (format.rows / ROUGH_ROWS).max(1);
    let (mut sum, mut count) = (0u64, 0u64);
    for row in words.chunks_exact(format.columns).step_by(every) {
        sum += row
            .windows(2)
            .map(|two| u64::from(stored(two[0]).abs_diff(stored(two[1]))))
            .sum::<u64>();
        count += row.len() as u64 - 1;
    }
    sum < ROUGH * count.max(1)
}
