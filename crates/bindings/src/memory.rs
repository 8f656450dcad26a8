//! End of the process where memory is exhausted: a message and exit code 1 instead of an abort with a stack trace.

use std::alloc::{GlobalAlloc, Layout, System};

#[global_allocator]
static ALLOCATOR: Reporting = Reporting;

/// Text for the user; the same as for a `MemoryError` of Python (`carina.cli.console`).
const MESSAGE: &[u8] =
    b"carina: not enough memory; close other programs, or use a smaller volume or image\n";

/// Allocator of the system, which ends the process with a message where the system has no memory.
///
/// Rust aborts in that case: its collections cannot return the error. The case is on the disk already.
struct Reporting;

/// Return a block of memory; end the process if there is none.
fn present(block: *mut u8) -> *mut u8 {
    if block.is_null() {
        end();
    }
    block
}

#[cold]
#[cfg(target_os = "linux")]
fn end() -> ! {
    // SAFETY: the buffer is valid for its length; `write` and `_exit` allocate nothing and run no handlers, which could
    // wait for a lock of this thread.
    unsafe {
        libc::write(2, MESSAGE.as_ptr().cast(), MESSAGE.len());
        libc::_exit(1)
    }
}

#[cold]
#[cfg(not(target_os = "linux"))]
fn end() -> ! {
    use std::io::Write;
    let _ = std::io::stderr().write_all(MESSAGE);
    std::process::abort()
}

// SAFETY: every call is passed to the system's allocator unchanged, so its guarantees hold.
unsafe impl GlobalAlloc for Reporting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller guarantees a layout of a size above 0.
        present(unsafe { System.alloc(layout) })
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller guarantees a layout of a size above 0.
        present(unsafe { System.alloc_zeroed(layout) })
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller guarantees that this allocator returned the block with this layout, and a size above 0.
        present(unsafe { System.realloc(block, layout, size) })
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: the caller guarantees that this allocator returned the block with this layout.
        unsafe { System.dealloc(block, layout) }
    }
}
