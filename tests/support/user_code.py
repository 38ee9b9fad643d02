"""Text of modules that the tests write as code of a user."""

STORED_LAW = '''
class StoredLaw:
    """The K_PMA of a file, with the number of its ticks."""
    def __init__(self):
        self.law = SampledSystem.from_file("k_pma.json")
    def reset(self):
        self.law.reset()
        self.tick = 0
    def step(self, accel_Ip, out):
        self.law.step(accel_Ip, out)
        self.tick += 1
'''
