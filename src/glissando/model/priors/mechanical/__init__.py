"""The mechanical prior: a rod of known stiffness and weight under unknown loads."""
