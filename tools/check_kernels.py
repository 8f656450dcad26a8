"""Find vector kernels of the compiled module that have lost their instruction set.

A closure inside a kernel may be compiled as a separate function without the kernel's instruction set: each vector
operation in it then becomes a call. The result is correct but several times slower, so no test notices. This program
searches the disassembled module for such calls.
"""

from __future__ import annotations

import platform
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

MODULE = Path(__file__).parents[1] / "python" / "carina" / "_core.abi3.so"
"""Path of the compiled module that is disassembled."""
FUNCTION = re.compile(r"^[0-9a-f]+ <(?P<name>.*)>:$")
"""Pattern of the first line of a function in the disassembly."""
OPERATION = re.compile(r"\bcall\b.*<core::core_arch::")
"""Pattern of a call of a vector operation."""
ALLOWED = ("compiler_builtins::", "std_detect::", "blake3::")
"""Name prefixes of functions that detect the processor's features once, and so may call vector operations."""


def lost_kernels(disassembly: str) -> Counter[str]:
    """Return the number of calls of vector operations in each function of the disassembly that contains such calls."""
    lost: Counter[str] = Counter()
    function = ""
    for line in disassembly.splitlines():
        if found := FUNCTION.match(line):
            function = found["name"]
        elif OPERATION.search(line) and not function.startswith(ALLOWED):
            lost[function] += 1
    return lost


def main() -> int:
    """Print the kernels that have lost their instruction set; return 1 if there are any."""
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        print("kernels: looked at on Linux with x86-64 alone")
        return 0
    command = ["objdump", "--disassemble", "--demangle", "--no-show-raw-insn", str(MODULE)]
    try:
        disassembly = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    except FileNotFoundError:
        print("kernels: needs objdump (Debian: binutils)", file=sys.stderr)
        return 1
    if "carina_raycast::packet" not in disassembly:
        print(f"kernels: {MODULE.name} has no names of functions to go by", file=sys.stderr)
        return 1
    lost = lost_kernels(disassembly)
    for function, calls in lost.most_common():
        print(f"{function}: {calls} vector operations are calls", file=sys.stderr)
    if lost:
        print("Make the closure a function with #[inline(always)], or write it out.", file=sys.stderr)
        return 1
    print("kernels: every vector operation is an instruction")
    return 0


if __name__ == "__main__":
    sys.exit(main())
