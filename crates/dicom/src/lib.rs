//! Fast reading of ordinary DICOM slices: header elements, lossless decoders, and checks of the pixels.
//!
//! Every function accepts only input that it fully understands and returns `None` for the rest: damaged, unusual or
//! doubtful files. The Python package reads these by pydicom and GDCM, which are slower and decide about errors and
//! notes. Tests compare both ways on the whole corpus of inputs.

mod excess;
mod header;
mod jpeg_lossless;
mod jpeg_ls;
mod pixels;
mod rle;
mod segments;

pub use excess::excesses;
pub use header::{HeaderElements, Wanted, scan_file};
pub use jpeg_lossless::decode_lossless_jpeg;
pub use jpeg_ls::decode_jpeg_ls;
pub use pixels::{Coding, SliceFormat, SliceSource, decode_slices};
pub use rle::decode_rle;
