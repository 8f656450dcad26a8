"""stub"""
from typing import Literal
Paper = Literal["A4","Letter"]
def pdf_pages(sheet, parts, *, paper): return b""
