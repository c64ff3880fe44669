"""What a vehicle engineer looks at first: free runs, axle forces, understeer, steering response, whiteness.

May import: what `scoring` may.
"""
