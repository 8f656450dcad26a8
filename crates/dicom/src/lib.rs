//! Fast reading of ordinary DICOM slices: header elements, uncompressed and RLE pixels, and checks of the pixels.
//!
//! Every function accepts only input that it fully understands and returns `None` for the rest: damaged, unusual or
//! doubtful files. The Python package reads these by pydicom and GDCM, which are slower and decide about errors and
//! notes. Tests compare both ways on the whole corpus of inputs.

mod excess;
mod header;
mod pixels;
mod rle;

pub use excess::excesses;
pub use header::{HeaderElements, Wanted, scan_file};
pub use pixels::{Coding, SliceFormat, SliceSource, decode_slices};
pub use rle::decode_rle;
