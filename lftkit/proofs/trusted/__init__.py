"""All that has to be trusted of this repository where a proof is checked: it imports nothing else of it.

A proof states a bound for all parameters in a box and all frequencies of a band. What found it, what wrote it and what
chose coordinates is elsewhere and need not be trusted: its numbers are checked here, with bounds of all rounding. A
check optimises nothing.

Read in this order:

=================  ====================================================================================================
``proof``          types of all kinds; why a proof is refused; whether boxes cover a box
``digests``        the names of plants by their numbers
``entries``        the strict reader: what is no proof by its form is refused before anything is computed
``arithmetic``     real matrices with a bound of every entry's error; positive definiteness beyond all rounding
``cells``          gain or stability: one quadratic form, negative definite, for each cell of parameters and frequency
``structured``     the structured singular value of a matrix, by one such form
``polynomials``    functions of the frequency over a window: polynomials with a bound of what is left out
``strips``         a quadratic form with scalings that depend on frequency, negative definite at every frequency
``axis``           gain or stability of a system over the whole axis, by strips with its responses
``loop``           responses of a sampled loop: hold, delay and frames are exact
``stability``      of the members of such a loop: of the nominal one, and that no pole crosses the axis
``sampled_loop``   gain of such a loop, with its premises
``lower_bound``    norm of the loop that no controller of a plant undercuts
``noise``          root mean square that white noise makes in it, by the gains in parts of the band
=================  ====================================================================================================

In each, a bound follows from one argument: for all parameters in the box a sum of terms that are not negative is added
to ``|e|^2 - level^2 |d|^2``. Where the whole is negative definite, so is the first: the gain is below the level, and
the equations have no solution but zero without an input, so that no pole is on the axis there.
"""
