function words = options (arguments)
% OPTIONS  Name-value pairs as options of the command: 'correct_poses', true becomes --correct-poses.
%   A logical value switches an option on or leaves it out; numbers, texts and vectors follow their option.
  if mod (numel (arguments), 2) ~= 0
    error ('lumenmesh:arguments', 'options: found %d arguments, expected pairs of name and value', numel (arguments));
  end
  words = {};
  for k = 1:2:numel (arguments)
    name = arguments{k};
    value = arguments{k + 1};
    if ~ischar (name)
      error ('lumenmesh:arguments', 'options: found a %s as name, expected a text', class (name));
    end
    option = ['--' strrep(name, '_', '-')];
    if islogical (value)
      if value
        words{end + 1} = option; %#ok<AGROW>
      end
    elseif ischar (value)
      words = [words {option, value}]; %#ok<AGROW>
    elseif isnumeric (value) && isreal (value)
      text = sprintf ('%.17g,', value);
      words = [words {option, text(1:end - 1)}]; %#ok<AGROW>
    else
      error ('lumenmesh:arguments', '%s: found a %s, expected a number, a text or true', name, class (value));
    end
  end
end
