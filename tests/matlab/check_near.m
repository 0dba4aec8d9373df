function check_near(value, expected, tolerance, what)
%CHECK_NEAR  Raise an error unless two arrays have the same size and nearly the same values.

    check(isequal(size(value), size(expected)), '%s: size %s where it should be %s', what, ...
        mat2str(size(value)), mat2str(size(expected)));
    check(all(abs(value(:) - expected(:)) <= tolerance), '%s: %s where it should be %s', what, ...
        mat2str(value, 6), mat2str(expected, 6));
end
