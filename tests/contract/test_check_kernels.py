"""Test of ``tools/check_kernels.py``: findings in a disassembly."""

from check_kernels import lost_kernels

DISASSEMBLY = """
0000000000001000 <carina_raycast::packet::lighting::light_row_avx512>:
    1000:\tvaddps %zmm0,%zmm1,%zmm2
    1006:\tcall   2000 <carina_raycast::packet::lighting::lit::{{closure}}>

0000000000002000 <carina_raycast::packet::lighting::lit::{{closure}}>:
    2000:\tcall   3000 <core::core_arch::x86::avx512f::_mm512_mul_ps>
    2005:\tcall   3010 <core::core_arch::x86::avx512f::_mm512_add_ps>
    200a:\tret

0000000000004000 <std_detect::detect::cache::detect_features>:
    4000:\tcall   5000 <core::core_arch::x86::xsave::_xgetbv>
"""


def test_closure_that_drops_the_instruction_set_of_its_kernel_is_reported() -> None:
    assert lost_kernels(DISASSEMBLY) == {"carina_raycast::packet::lighting::lit::{{closure}}": 2}
