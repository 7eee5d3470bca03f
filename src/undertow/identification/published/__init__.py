"""Tables of estimates as a paper printed them, and what does not fit in them."""

from .audit import KINDS, Remark, audit
from .tables import Adopted, Appendix, Table, appendix

__all__ = ["KINDS", "Adopted", "Appendix", "Remark", "Table", "appendix", "audit"]
