"""CycloneDDS through its C interface, 0.10.2 and 11: messages are `ctypes.Structure`s in the order of the vendor's IDL.

The library's Python binding is no alternative: from version 11 on it announces its types in a form that crashes peers
with CycloneDDS 0.10.2 (robots, Unitree's SDK), and it builds messages field by field. Through C the announcement is
left out, and peers match by the type's name. Messages are serialised from memory in C's layout, which NumPy and
checksums use too.
"""
