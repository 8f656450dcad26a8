//! Elements of a DICOM header as stored, up to the pixels (PS3.5 7, PS3.10 7).

use std::fs::File;
use std::io::Read;
use std::path::Path;

use miniz_oxide::inflate::decompress_to_vec_with_limit;

const PIXEL_DATA: u32 = 0x7fe0_0010;
const ITEM: u32 = 0xfffe_e000;
const END_OF_ITEM: u32 = 0xfffe_e00d;
const END_OF_SEQUENCE: u32 = 0xfffe_e0dd;
const UNDEFINED: u32 = u32::MAX;
const CHARACTER_SET: u32 = 0x0008_0005;
const FIRST_READ: usize = 1 << 13;
/// Largest part of a file that is searched for the pixels, bytes.
const MAX_HEADER: usize = 1 << 20;
/// Deepest nesting of sequences that is followed.
const MAX_DEPTH: usize = 16;
/// Value representations with a length of two bytes and of four bytes (PS3.5 7.1.2).
const SHORT: [&[u8; 2]; 21] = [
    b"AE", b"AS", b"AT", b"CS", b"DA", b"DS", b"DT", b"FD", b"FL", b"IS", b"LO", b"LT", b"PN",
    b"SH", b"SL", b"SS", b"ST", b"TM", b"UI", b"UL", b"US",
];
const LONG: [&[u8; 2]; 13] = [
    b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SQ", b"SV", b"UC", b"UN", b"UR", b"UT", b"UV",
];

/// Transfer syntaxes whose data sets are read, beside the ones for compressed pixels.
pub(crate) const IMPLICIT: &[u8] = b"1.2.840.10008.1.2";
pub(crate) const BIG_ENDIAN: &[u8] = b"1.2.840.10008.1.2.2";
pub(crate) const DEFLATED: &[u8] = b"1.2.840.10008.1.2.1.99";
const EXPLICIT: [&[u8]; 12] = [
    b"1.2.840.10008.1.2.1",
    b"1.2.840.10008.1.2.5",
    b"1.2.840.10008.1.2.4.50",
    b"1.2.840.10008.1.2.4.51",
    b"1.2.840.10008.1.2.4.53",
    b"1.2.840.10008.1.2.4.55",
    b"1.2.840.10008.1.2.4.57",
    b"1.2.840.10008.1.2.4.70",
    b"1.2.840.10008.1.2.4.80",
    b"1.2.840.10008.1.2.4.81",
    b"1.2.840.10008.1.2.4.90",
    b"1.2.840.10008.1.2.4.91",
];

/// Tags of the elements that [`scan_file`] returns.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Elements that most slices of a series share, ascending.
    pub shared: Vec<u32>,
    /// Elements with a value for each slice, ascending; they are not in `shared`.
    pub single: Vec<u32>,
    /// Elements whose presence makes a file unsuitable, ascending.
    pub refused: Vec<u32>,
    /// Largest decompressed size of a deflated file, bytes.
    pub max_inflated: usize,
}

/// Elements of the header of one file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HeaderElements {
    /// Bytes that are equal for two files if and only if all shared elements are equal, with their types and the
    /// transfer syntax, and the same single elements are present.
    pub key: Vec<u8>,
    /// Values of the single elements; `None` for an absent one.
    pub single: Vec<Option<Vec<u8>>>,
    /// Offset of the element `PixelData` in the file; `None` in a deflated file.
    pub pixels_at: Option<u64>,
}

/// Encoding of a data set.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Encoding {
    pub(crate) explicit: bool,
    pub(crate) little: bool,
}

/// Result of reading a part of a file.
#[derive(Debug)]
enum Cut {
    /// The part ends within an element.
    More,
    /// The file is unsuitable.
    Unsuitable,
}

type Parsed<T> = Result<T, Cut>;

struct Element {
    tag: u32,
    vr: [u8; 2],
    length: u32,
    value_at: usize,
}

struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
    encoding: Encoding,
}

impl Cursor<'_> {
    fn take<const N: usize>(&mut self) -> Parsed<[u8; N]> {
        let found = self.bytes.get(self.at..self.at + N).ok_or(Cut::More)?;
        self.at += N;
        Ok(found.try_into().expect("N bytes"))
    }

    fn u16(&mut self) -> Parsed<u16> {
        let found = self.take()?;
        Ok(if self.encoding.little {
            u16::from_le_bytes(found)
        } else {
            u16::from_be_bytes(found)
        })
    }

    fn u32(&mut self) -> Parsed<u32> {
        let found = self.take()?;
        Ok(if self.encoding.little {
            u32::from_le_bytes(found)
        } else {
            u32::from_be_bytes(found)
        })
    }

    fn tag(&mut self) -> Parsed<u32> {
        let group = self.u16()?;
        Ok(u32::from(group) << 16 | u32::from(self.u16()?))
    }

    fn element(&mut self) -> Parsed<Element> {
        let tag = self.tag()?;
        let mut vr = [0, 0];
        let length;
        // Items and delimiters have no type in any encoding.
        if !self.encoding.explicit || tag >> 16 == 0xfffe {
            length = self.u32()?;
        } else {
            vr = self.take()?;
            if SHORT.contains(&&vr) {
                length = u32::from(self.u16()?);
            } else if LONG.contains(&&vr) {
                self.take::<2>()?;
                length = self.u32()?;
            } else {
                return Err(Cut::Unsuitable);
            }
        }
        Ok(Element {
            tag,
            vr,
            length,
            value_at: self.at,
        })
    }

    fn skip(&mut self, length: u32) -> Parsed<()> {
        self.at = self
            .at
            .checked_add(length as usize)
            .ok_or(Cut::Unsuitable)?;
        if self.at > self.bytes.len() {
            Err(Cut::More)
        } else {
            Ok(())
        }
    }

    /// Skip the items of a sequence of undefined length, with its delimiter.
    fn skip_items(&mut self, depth: usize) -> Parsed<()> {
        if depth > MAX_DEPTH {
            return Err(Cut::Unsuitable);
        }
        loop {
            let item = self.element()?;
            match (item.tag, item.length) {
                (END_OF_SEQUENCE, 0) => return Ok(()),
                (ITEM, UNDEFINED) => self.skip_elements(depth)?,
                (ITEM, length) => self.skip(length)?,
                _ => return Err(Cut::Unsuitable),
            }
        }
    }

    /// Skip the elements of an item of undefined length, with its delimiter.
    fn skip_elements(&mut self, depth: usize) -> Parsed<()> {
        loop {
            let inner = self.element()?;
            match (inner.tag, inner.length) {
                (END_OF_ITEM, 0) => return Ok(()),
                (tag, _) if tag >> 16 == 0xfffe => return Err(Cut::Unsuitable),
                (_, UNDEFINED) => self.skip_undefined(&inner, depth + 1)?,
                (_, length) => self.skip(length)?,
            }
        }
    }

    /// Skip a value of undefined length, if it is certainly a sequence.
    fn skip_undefined(&mut self, element: &Element, depth: usize) -> Parsed<()> {
        if self.encoding.explicit && &element.vr != b"SQ" {
            return Err(Cut::Unsuitable);
        }
        self.skip_items(depth)
    }
}

/// Return the wanted elements of a file with one image; `None` for every file that is not plainly readable.
///
/// The file must have a preamble, a known transfer syntax, ascending tags, no refused element, and pixels.
pub fn scan_file(path: &Path, wanted: &Wanted) -> Option<HeaderElements> {
    let mut file = open_regular(path)?;
    let mut bytes = Vec::new();
    let mut limit = FIRST_READ;
    loop {
        (&mut file)
            .take((limit - bytes.len()) as u64)
            .read_to_end(&mut bytes)
            .ok()?;
        let whole = bytes.len() < limit;
        match scan(&bytes, wanted, &mut file) {
            Ok(found) => return Some(found),
            Err(Cut::More) if !whole && limit < MAX_HEADER => limit *= 4,
            Err(_) => return None,
        }
    }
}

/// Open a regular file; other kinds, such as pipes, could block.
pub(crate) fn open_regular(path: &Path) -> Option<File> {
    if !path.metadata().ok()?.is_file() {
        return None;
    }
    let file = File::open(path).ok()?;
    file.metadata().ok()?.is_file().then_some(file)
}

/// Return the transfer syntax of a file and the offset of its data set, from its first bytes.
fn read_meta(bytes: &[u8]) -> Parsed<(&[u8], usize)> {
    if bytes.get(128..132).ok_or(Cut::Unsuitable)? != b"DICM" {
        return Err(Cut::Unsuitable);
    }
    let encoding = Encoding {
        explicit: true,
        little: true,
    };
    let mut cursor = Cursor {
        bytes,
        at: 132,
        encoding,
    };
    let (mut syntax, mut stated_end, mut last) = (None, None, 0);
    loop {
        let begin = cursor.at;
        if bytes.get(begin..begin + 2).ok_or(Cut::More)? != [2, 0] {
            let syntax = syntax.ok_or(Cut::Unsuitable)?;
            // The reference finds the deflated data set by the stated length of the group.
            if syntax == DEFLATED && stated_end != Some(begin) {
                return Err(Cut::Unsuitable);
            }
            return Ok((syntax, begin));
        }
        let element = cursor.element()?;
        if element.length == UNDEFINED || (last != 0 && element.tag <= last) {
            return Err(Cut::Unsuitable);
        }
        last = element.tag;
        cursor.skip(element.length)?;
        let value = &bytes[element.value_at..cursor.at];
        match (element.tag, &element.vr, value) {
            (0x0002_0000, b"UL", [a, b, c, d]) => {
                let length = u32::from_le_bytes([*a, *b, *c, *d]) as usize;
                stated_end = cursor.at.checked_add(length);
            }
            (0x0002_0010, b"UI", value) => {
                syntax = Some(value.strip_suffix(b"\0").unwrap_or(value));
            }
            (0x0002_0000 | 0x0002_0010, ..) => return Err(Cut::Unsuitable),
            _ => {}
        }
    }
}

fn encoding_of(syntax: &[u8]) -> Option<Encoding> {
    let known = syntax == IMPLICIT
        || syntax == BIG_ENDIAN
        || syntax == DEFLATED
        || EXPLICIT.contains(&syntax);
    known.then_some(Encoding {
        explicit: syntax != IMPLICIT,
        little: syntax != BIG_ENDIAN,
    })
}

fn scan(bytes: &[u8], wanted: &Wanted, file: &mut File) -> Parsed<HeaderElements> {
    let (syntax, at) = read_meta(bytes)?;
    let encoding = encoding_of(syntax).ok_or(Cut::Unsuitable)?;
    if syntax != DEFLATED {
        return scan_data_set(bytes, at, syntax, encoding, wanted);
    }
    let inflated = inflate_rest(bytes, at, file, wanted.max_inflated).ok_or(Cut::Unsuitable)?;
    let found =
        scan_data_set(&inflated, 0, syntax, encoding, wanted).map_err(|_| Cut::Unsuitable)?;
    Ok(HeaderElements {
        pixels_at: None,
        ..found
    })
}

/// Decompress the data set of a deflated file, of which the first bytes are read already.
fn inflate_rest(bytes: &[u8], at: usize, file: &mut File, limit: usize) -> Option<Vec<u8>> {
    let mut packed = bytes[at..].to_vec();
    file.take(limit as u64).read_to_end(&mut packed).ok()?;
    decompress_to_vec_with_limit(&packed, limit).ok()
}

/// Return the decompressed data set of a deflated file, with the offset of the element `PixelData`.
pub(crate) fn inflated_pixels(path: &Path, limit: usize) -> Option<(Vec<u8>, usize)> {
    let mut file = open_regular(path)?;
    let mut bytes = Vec::new();
    (&mut file)
        .take(FIRST_READ as u64)
        .read_to_end(&mut bytes)
        .ok()?;
    let (syntax, at) = read_meta(&bytes).ok()?;
    if syntax != DEFLATED {
        return None;
    }
    let inflated = inflate_rest(&bytes, at, &mut file, limit)?;
    let none = Wanted {
        shared: vec![],
        single: vec![],
        refused: vec![],
        max_inflated: 0,
    };
    let encoding = Encoding {
        explicit: true,
        little: true,
    };
    let pixels_at = scan_data_set(&inflated, 0, DEFLATED, encoding, &none)
        .ok()?
        .pixels_at? as usize;
    Some((inflated, pixels_at))
}

fn scan_data_set(
    bytes: &[u8],
    at: usize,
    syntax: &[u8],
    encoding: Encoding,
    wanted: &Wanted,
) -> Parsed<HeaderElements> {
    // pydicom reads a data set with explicit types even if the transfer syntax has none.
    if !encoding.explicit
        && bytes
            .get(at + 4..at + 6)
            .ok_or(Cut::More)?
            .iter()
            .all(u8::is_ascii_uppercase)
    {
        return Err(Cut::Unsuitable);
    }
    let mut cursor = Cursor {
        bytes,
        at,
        encoding,
    };
    let mut key = syntax.to_vec();
    let mut single = vec![None; wanted.single.len()];
    let mut last = 0;
    loop {
        let begin = cursor.at;
        let element = cursor.element()?;
        if element.tag <= last || element.tag >> 16 < 8 {
            return Err(Cut::Unsuitable);
        }
        last = element.tag;
        if element.tag == PIXEL_DATA {
            return Ok(HeaderElements {
                key,
                single,
                pixels_at: Some(begin as u64),
            });
        }
        if element.tag > PIXEL_DATA || matches!(element.tag, 0x7fe0_0008 | 0x7fe0_0009) {
            return Err(Cut::Unsuitable);
        }
        if wanted.refused.binary_search(&element.tag).is_ok() {
            return Err(Cut::Unsuitable);
        }
        let shared =
            element.tag == CHARACTER_SET || wanted.shared.binary_search(&element.tag).is_ok();
        let own = wanted.single.binary_search(&element.tag).ok();
        if element.length == UNDEFINED {
            if shared || own.is_some() {
                return Err(Cut::Unsuitable);
            }
            cursor.skip_undefined(&element, 0)?;
            continue;
        }
        cursor.skip(element.length)?;
        if shared || own.is_some() {
            key.extend_from_slice(&element.tag.to_le_bytes());
            key.extend_from_slice(&element.vr);
        }
        let value = &bytes[element.value_at..cursor.at];
        if shared {
            key.extend_from_slice(&element.length.to_le_bytes());
            key.extend_from_slice(value);
        }
        if let Some(number) = own {
            single[number] = Some(value.to_vec());
        }
    }
}
