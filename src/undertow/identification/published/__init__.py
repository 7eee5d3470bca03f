"""Tables of estimates as a paper printed them, and what does not fit in them."""

from .audit import KINDS, Remark, audit
from .tables import Adopted, Appendix, PublishedTable, appendix

__all__ = ["KINDS", "Adopted", "Appendix", "PublishedTable", "Remark", "appendix", "audit"]
